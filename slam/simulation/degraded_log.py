"""A log made worse: what ``slam.simulation.degradation`` does to detections and odometry, done to a whole log."""

from __future__ import annotations

import json
from collections import Counter, defaultdict, deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path

import numpy as np

from logs.errors import UnwritableLogError
from logs.messages import DetectionTruth, ObjectDetections, Odometry, Record, Transform
from logs.reader import LogItem, LogReader
from logs.selection import Selection, select_topics
from logs.topics import RawMessage, RecordKind
from logs.writer import LogWriter, partial_path
from slam.common.arrays import FloatArray
from slam.common.geometry import invert, make_transform, transform_from_xyz_yaw
from slam.simulation.degradation import (
    DegradationConfig,
    DegradationStreams,
    DegradedScan,
    Donors,
    choose_labels,
    degrade_detections,
)
from slam.simulation.log_survey import (
    LogSurvey,
    edge,
    find_donors,
    refuse_odometry_frame,
    refuse_shared_topics,
    survey_log,
)


@dataclass(frozen=True, slots=True)
class DegradationSummary:
    """What became of a log.

    ``counts``: detections, and what happened to them; ``left_out``: messages that are not in the output, by reason.
    """

    message_counts: dict[str, int]
    counts: dict[str, int]
    left_out: dict[str, int]


@dataclass(frozen=True, slots=True, eq=False)
class _Message:
    """A message of the output: as it was read, or a record; ``is_timeless``: the same in a drive played backwards."""

    topic: str
    log_time_ns: int
    content: RawMessage | Record
    is_timeless: bool = False


def write_degraded(
    source: Path,
    output: Path,
    config: DegradationConfig,
    *,
    seed: int,
    topics: Mapping[str, str] | None = None,
    progress: Callable[[float], None] | None = None,
) -> DegradationSummary:
    """Write the log ``source``, made worse, as the log ``output``, with the metadata "degradation".

    First the times: a drive played backwards has all stamps mirrored about its span, then the detections' stamps get
    their offset. Then the detections, in the order that ``slam.simulation.degradation`` tells; last the odometry.
    Sensors are taken to stand still on the body, where the last transform says; without one the body's axes are theirs.
    The true ids follow the detections. All else is copied, but for a drive played backwards: there, topics that are
    none of odometry, detections, transforms and truths are left out, for their content cannot be reversed.

    Args:
        source: a log with detections, and with odometry if it is to change or to tell where ahead is.
        output: replaced if it is there; written as NAME.part and renamed when finished.
        config: what to do; written into the output together with ``seed``.
        seed: the same seed, configuration and input give the same bytes.
        topics: kind -> topic, where the log leaves a choice.
        progress: called with the fraction done, in [0, 1].

    Raises:
        LogError: the input cannot be read or the output cannot be written.
        SimulationError: the log has not what the configuration needs, or the seed is negative.
    """
    streams = DegradationStreams.of_seed(seed)
    needed = [RecordKind.DETECTIONS]
    # The odometry also tells which frame is the body's.
    is_driving = config.reversed or config.changes_odometry or config.needs_bearings
    needed += [RecordKind.ODOMETRY] if is_driving else []
    with LogReader(source) as reader:
        for path in (output, partial_path(output)):
            if path.exists() and path.samefile(source):
                raise UnwritableLogError(f"writing {output} would overwrite the input {source}; give another output")
        selection = select_topics(reader.topics(), topics, needed=needed)
        refuse_shared_topics(selection, config)
        survey = survey_log(reader, selection)
        labels = choose_labels(sorted(survey.labels), config)
        refuse_odometry_frame(survey, config)
        donors = find_donors(reader, selection, survey, config, labels) if config.false_positives else None
        has_truth = bool(selection.topics_of(RecordKind.DETECTION_TRUTH))
        degrading = _Degrading(config, survey, labels, donors, streams, has_truth=has_truth)
        written: Counter[str] = Counter()
        with LogWriter(output) as writer:
            _copy_metadata(reader, writer, config, seed)
            items = reader.items(selection, copy=[info.topic for info in reader.topics()])
            for message in degrading.messages(_told(items, reader, progress), selection):
                if isinstance(message.content, RawMessage):
                    writer.write_raw(message.content)
                else:
                    writer.write(message.topic, message.content, message.log_time_ns)
                written[message.topic] += 1
        degrading.left_out.update(reader.counters)
    return DegradationSummary(
        dict(sorted(written.items())), dict(degrading.counts), dict(sorted(degrading.left_out.items()))
    )


class OdometryDrift:
    """Noise on the steps of an odometry, which adds up to a drift.

    Each step of length d gets N(0, d sigma^2) on each axis of its translation and on its heading, with the sigmas
    ``odometry_translation_noise`` and ``odometry_yaw_noise``: the model of ``slam.common.config.OdometryConfig``.
    """

    def __init__(self, config: DegradationConfig, *, rng: np.random.Generator) -> None:
        self._config = config
        self._rng = rng
        self._T_odom_before: FloatArray | None = None
        self._T_odom_drifted = np.eye(4)

    def add(self, odometry: Odometry) -> Odometry:
        """The next message with the drift that has gathered; the first one stays as it is."""
        before, self._T_odom_before = self._T_odom_before, odometry.T_odom_body
        if before is None:
            self._T_odom_drifted = odometry.T_odom_body
            return odometry
        T_before_body = invert(before) @ odometry.T_odom_body
        root_m = float(np.sqrt(np.linalg.norm(T_before_body[:3, 3])))
        xyz = self._rng.standard_normal(3) * self._config.odometry_translation_noise * root_m
        yaw_rad = float(self._rng.standard_normal()) * self._config.odometry_yaw_noise * root_m
        T_error = transform_from_xyz_yaw(np.zeros(3), yaw_rad)
        step = make_transform(T_before_body[:3, :3] @ T_error[:3, :3], T_before_body[:3, 3] + xyz)
        self._T_odom_drifted = self._T_odom_drifted @ step
        return replace(odometry, T_odom_body=self._T_odom_drifted)


class _Degrading:
    """One pass over a log."""

    def __init__(
        self,
        config: DegradationConfig,
        survey: LogSurvey,
        labels: tuple[str, ...],
        donors: Donors | None,
        streams: DegradationStreams,
        *,
        has_truth: bool,
    ) -> None:
        self._config = config
        self._survey = survey
        self._labels = labels
        self._donors = donors
        self._streams = streams
        self._has_truth = has_truth
        self._drift = OdometryDrift(config, rng=streams.odometry) if config.changes_odometry else None
        self._scans: defaultdict[int, deque[DegradedScan]] = defaultdict(deque)
        self._truths: defaultdict[int, deque[tuple[_Message, DetectionTruth]]] = defaultdict(deque)
        names = ("detections", "out_of_view", "unwanted_label", "dropped_out", "kept", "relabelled", "false_positives")
        self.counts = Counter(dict.fromkeys(names, 0))
        self.left_out: Counter[str] = Counter()

    def messages(self, items: Iterator[LogItem], selection: Selection) -> Iterator[_Message]:
        """The messages of the output, in the order of its time."""
        found = (message for item in items for message in self._content(item, selection.kinds.get(item.raw.topic, ())))
        for message in self._mirrored(found) if self._config.reversed else found:
            yield from self._shifted(message)
        self.left_out["true_ids_without_detections"] += sum(map(len, self._truths.values()))
        self.left_out = +self.left_out

    def _content(self, item: LogItem, kinds: tuple[RecordKind, ...]) -> Iterator[_Message]:
        """The message itself where it stays as it is, else its records, with the detections degraded."""
        raw = item.raw
        if not self._config.changes_detections:
            count = sum(len(record.labels) for record in item.records if isinstance(record, ObjectDetections))
            self.counts.update(detections=count, kept=count)
        if not self._is_rewritten(raw.topic, kinds):
            is_timeless = bool({RecordKind.TRANSFORMS, RecordKind.OBJECT_TRUTH} & set(kinds))
            if is_timeless or not self._config.reversed:
                yield _Message(raw.topic, raw.log_time_ns, raw, is_timeless)
            else:
                self.left_out["irreversible_messages"] += 1
            return
        for record in item.records:
            if isinstance(record, ObjectDetections) and self._config.changes_detections:
                yield from self._scan(_Message(raw.topic, raw.log_time_ns, record), record)
            elif isinstance(record, DetectionTruth) and self._config.changes_detections:
                self._truths[record.stamp_ns].append((_Message(raw.topic, raw.log_time_ns, record), record))
                yield from self._paired(record.stamp_ns)
            else:
                moves = not isinstance(record, Transform) or edge(record) in self._survey.moving
                yield _Message(raw.topic, raw.log_time_ns, record, is_timeless=not moves)

    def _is_rewritten(self, topic: str, kinds: tuple[RecordKind, ...]) -> bool:
        config, kind = self._config, kinds[0] if kinds else None
        if kind in (RecordKind.DETECTIONS, RecordKind.DETECTION_TRUTH):
            return config.changes_detections or config.reversed
        if kind is RecordKind.ODOMETRY:
            return config.changes_odometry or config.reversed
        if kind is RecordKind.TRANSFORMS:
            return config.reversed and topic in self._survey.moving_topics
        return config.reversed and kind is RecordKind.GROUND_TRUTH

    def _scan(self, message: _Message, record: ObjectDetections) -> Iterator[_Message]:
        R_body_sensor = self._survey.R_body_sensor(record.frame_id)
        scan = degrade_detections(record, R_body_sensor, self._config, self._labels, self._donors, self._streams)
        self.counts.update(
            detections=len(record.labels),
            out_of_view=scan.out_of_view,
            unwanted_label=scan.unwanted,
            dropped_out=scan.dropped,
            kept=int(scan.kept.sum()),
            relabelled=scan.confused,
            false_positives=scan.false_positive_count,
        )
        yield replace(message, content=scan.detections)
        if self._has_truth:
            self._scans[record.stamp_ns].append(scan)
            yield from self._paired(record.stamp_ns)

    def _paired(self, stamp_ns: int) -> Iterator[_Message]:
        """The truth of that stamp, once both it and the detections are there, in whatever order they stand."""
        scans, truths = self._scans[stamp_ns], self._truths[stamp_ns]
        while scans and truths:
            scan, (message, truth) = scans.popleft(), truths.popleft()
            left = scan.true_ids(truth)
            if left is None:
                self.left_out["true_ids_of_other_detections"] += 1
            else:
                yield replace(message, content=left)
        for waiting in (self._scans, self._truths):
            if not waiting[stamp_ns]:
                del waiting[stamp_ns]

    def _mirrored(self, messages: Iterator[_Message]) -> list[_Message]:
        """The drive backwards; what lies between a stamp and its log time stays."""
        mirror_ns = self._survey.first_ns + self._survey.last_ns
        found = []
        for message in messages:
            if not message.is_timeless and not isinstance(message.content, RawMessage):
                stamp_ns = mirror_ns - message.content.stamp_ns
                log_time_ns = max(stamp_ns + message.log_time_ns - message.content.stamp_ns, 0)
                message = replace(message, log_time_ns=log_time_ns, content=replace(message.content, stamp_ns=stamp_ns))
            found.append(message)
        return sorted(found, key=lambda message: message.log_time_ns)

    def _shifted(self, message: _Message) -> Iterator[_Message]:
        """The message with the drift or the offset of its kind; none where its stamp would be before zero."""
        content = message.content
        if isinstance(content, Odometry) and self._drift is not None:
            content = self._drift.add(content)
        elif isinstance(content, (ObjectDetections, DetectionTruth)):
            content = replace(content, stamp_ns=content.stamp_ns + round(self._config.time_offset_s * 1e9))
        if not isinstance(content, RawMessage) and content.stamp_ns < 0:
            self.left_out["stamps_before_zero"] += 1
            return
        yield replace(message, content=content)


def _copy_metadata(reader: LogReader, writer: LogWriter, config: DegradationConfig, seed: int) -> None:
    """What the input tells of itself, and how this log was made from it; a second degradation hides no first one."""
    before = reader.metadata()
    for name, values in before.items():
        writer.add_metadata(name, values)
    taken = sum(name.partition("_")[0] == "degradation" for name in before)
    writer.add_metadata(
        f"degradation_{taken + 1}" if taken else "degradation",
        {
            "version": version("descriptellation-slam"),
            "seed": str(seed),
            "input_sha256": reader.sha256(),
            **{name: json.dumps(value) for name, value in config.in_effect().items()},
        },
    )


def _told(items: Iterator[LogItem], reader: LogReader, progress: Callable[[float], None] | None) -> Iterator[LogItem]:
    total = max(sum(info.message_count for info in reader.topics()), 1)
    for done, item in enumerate(items, start=1):
        yield item
        if progress is not None:
            progress(min(done / total, 1.0))
