"""What is read of a log before it is mapped: its topics and frames, and the settings that are estimated from it."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

from threadpoolctl import threadpool_limits

from logs.errors import TopicSelectionError
from logs.messages import Transform
from logs.reader import LogReader
from logs.selection import OUTPUT_PREFIX, Selection, select_topics
from logs.topics import RecordKind
from slam.common.config import Config
from slam.display.drive_display import FRAMES
from slam.frontend.input.input_records import InputRecords
from slam.frontend.input.label_map import LabelMap
from slam.frontend.input.scan_objects import ScanObjects
from slam.frontend.input.sensor_frames import SensorFrames
from slam.frontend.input.stamp_clocks import NO_DRIFT, ClockDrift, StampClocks
from slam.self_calibration.calibration import CalibratedLog, calibrate
from slam.self_calibration.survey import Survey, survey

_MAPPED = (
    RecordKind.ODOMETRY,
    RecordKind.DETECTIONS,
    RecordKind.TRANSFORMS,
    RecordKind.CAMERA_INFO,
    RecordKind.DEPTH,
    RecordKind.GNSS,
)
# The estimator never sees these; they are copied as they are, so that the output can be evaluated on its own.
_COPIED = (RecordKind.ODOMETRY, RecordKind.GROUND_TRUTH, RecordKind.DETECTION_TRUTH, RecordKind.OBJECT_TRUTH)


@dataclass(frozen=True, slots=True, eq=False)
class PreparedLog:
    """A log that can be mapped.

    ``selection``: all topics that were chosen; ``mapped``: those of them that are mapped, without transforms, which are
    in ``frames``; ``copied``: topics that go into the output as they are; ``first_ns``, ``last_ns``: log times of the
    first and the last message that is mapped; ``scans``: objects of point clouds and images; ``drift``: of the clock of
    the detections; ``lost``: what could not be decoded of the transforms and of the beginning, by reason.
    """

    selection: Selection
    mapped: Selection
    copied: frozenset[str]
    first_ns: int
    last_ns: int
    labels: LabelMap
    frames: SensorFrames
    scans: ScanObjects
    calibration: CalibratedLog
    drift: ClockDrift
    lost: Mapping[str, int]

    def inputs(self) -> InputRecords:
        """What makes records of the log those of the estimator, with the estimated settings."""
        return InputRecords(self.calibration.config, self.labels, self.frames, self.scans)


def prepare_log(
    reader: LogReader, config: Config, *, topics: Mapping[str, str] | None, copy: Collection[str]
) -> PreparedLog:
    """Choose the topics of a log, read all frames, and estimate what was not set by hand.

    Args:
        reader: of the log.
        config: as it was given.
        topics: kind -> topic, where the log leaves a choice.
        copy: further topics that go into the output.

    Raises:
        LogError: the log cannot be read, or lacks a topic.
        SlamError: its transforms contradict one another.
    """
    selection = select_topics(reader.topics(), {**config.topics, **(topics or {})})
    copied = _copied_topics(reader, selection, copy)
    mapped = Selection({topic: kinds for topic, kinds in selection.kinds.items() if set(kinds) & set(_MAPPED)})
    first_ns, last_ns = _span(reader, mapped)
    # Where the sensors are is read beforehand: between two transforms only when the later one is known, too.
    frames = _read_frames(reader, mapped)
    lost = reader.decoding_counters
    mapped = mapped.without(RecordKind.TRANSFORMS)
    labels = LabelMap(config.labels)
    scans = ScanObjects(labels, frames)
    calibration, drift = _calibrate(reader, mapped, config, InputRecords(config, labels, frames, scans), frames)
    return PreparedLog(selection, mapped, copied, first_ns, last_ns, labels, frames, scans, calibration, drift, lost)


def _copied_topics(reader: LogReader, selection: Selection, wanted: Collection[str]) -> frozenset[str]:
    """What goes into the output as it is: what an evaluation needs, and what is ``wanted``."""
    copied = {topic for kind in _COPIED for topic in selection.topics_of(kind)}
    copied |= set(selection.topics_of(RecordKind.TRANSFORMS)) - {FRAMES}
    return frozenset(copied | _checked_copies(reader, wanted))


def _checked_copies(reader: LogReader, topics: Collection[str]) -> set[str]:
    """``topics``, if the log has all of them.

    Raises:
        TopicSelectionError: it lacks one, or the output has a topic of that name.
    """
    there = {info.topic for info in reader.topics()}
    for topic in topics:
        if topic == FRAMES or topic.startswith(OUTPUT_PREFIX):
            raise TopicSelectionError(f"{topic} cannot be copied: the output has a topic of that name of its own")
        if topic not in there:
            raise TopicSelectionError(f"the log has no topic {topic} to copy; it has {', '.join(sorted(there))}")
    return set(topics)


def _span(reader: LogReader, selection: Selection) -> tuple[int, int]:
    """First and last log time [ns] of the selected topics."""
    infos = [info for info in reader.topics() if info.topic in selection.topics]
    first = [info.first_log_time_ns for info in infos if info.first_log_time_ns is not None]
    last = [info.last_log_time_ns for info in infos if info.last_log_time_ns is not None]
    return min(first, default=0), max(last, default=0)


def _read_frames(reader: LogReader, selection: Selection) -> SensorFrames:
    frames = SensorFrames()
    for entry in reader.records(selection.only(RecordKind.TRANSFORMS)):
        if isinstance(entry.record, Transform):
            frames.add(entry.record)
    return frames


def _calibrate(
    reader: LogReader, selection: Selection, config: Config, inputs: InputRecords, frames: SensorFrames
) -> tuple[CalibratedLog, ClockDrift]:
    """The settings for a log, of which those that were not given by hand are estimated from it, and how the clock of
    its detections drifts.
    """
    if not config.calibrate:
        return CalibratedLog(config), NO_DRIFT
    found, clocks = _survey(reader, selection, config, inputs, frames, NO_DRIFT)
    drift = clocks.drift()
    if drift.rate:
        found, clocks = _survey(reader, selection, config, inputs, frames, drift)
    return calibrate(config, found, clocks.delays()), drift


def _survey(
    reader: LogReader,
    selection: Selection,
    config: Config,
    inputs: InputRecords,
    frames: SensorFrames,
    drift: ClockDrift,
) -> tuple[Survey | None, StampClocks]:
    clocks = StampClocks(drift)
    items = reader.items(selection, again_follows=True)
    records = inputs.prepare(record for item in items for record in clocks.follow(item))
    with threadpool_limits(1, user_api="blas"):
        found = survey(
            records,
            config.calibration.detection,
            frames,
            max_classes=config.calibration.objects.max_classes,
            given=config.calibration.odometry.model_fields_set,
        )
    return found, clocks
