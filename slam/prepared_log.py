"""Preparation of a log: its topics and frames, and the settings that are estimated from it."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from threadpoolctl import threadpool_limits

from logs.errors import TopicSelectionError
from logs.messages import Transform
from logs.reader import LogReader
from logs.records import frozen
from logs.selection import OUTPUT_PREFIX, Selection, select_topics
from logs.topics import RecordKind
from slam.common.calibration import Calibration
from slam.common.config import Config
from slam.common.errors import InputDataError
from slam.display.map_topics import FRAMES
from slam.frontend.input.input_records import InputRecords, ScanObjects
from slam.frontend.input.label_map import LabelMap
from slam.frontend.input.sensor_frames import SensorFrames
from slam.frontend.input.stamp_clocks import NO_DRIFT, ClockDrift, LoggingDelays, StampClocks
from slam.self_calibration.calibration import CalibratedLog, calibrate
from slam.self_calibration.survey import survey
from slam.self_calibration.surveyed_log import MAX_DETECTIONS, SurveyedLog

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


@frozen
class PreparedLog:
    """A log with the topics, frames and settings for a replay.

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
        """Conversion of records of the log to those of the estimator, by the calibration."""
        return InputRecords(self.calibration.config, self.labels, self.frames, self.scans)


def prepare_log(
    reader: LogReader, config: Config, *, topics: Mapping[str, str] | None, copy: Collection[str], is_surveyed: bool
) -> PreparedLog:
    """Choose the topics of a log, read all frames, and estimate what was not given of its calibration, if it
    ``is_surveyed``.

    Args:
        reader: of the log.
        config: as it was given.
        topics: kind -> topic, where the log leaves a choice.
        copy: further topics that go into the output.

    Raises:
        LogError: the log cannot be read, or lacks a topic.
        SlamError: its transforms contradict one another.
    """
    log = _open(reader, config, topics, copy)
    if not is_surveyed or not config.calibrate or config.calibration.is_complete:
        return log
    surveyed, delays, drift = _survey(reader, log, MAX_DETECTIONS)
    found = survey([surveyed], config.calibration)
    return replace(log, calibration=calibrate(config, found, delays), drift=drift)


def calibrate_logs(paths: Sequence[Path], config: Config, *, topics: Mapping[str, str] | None = None) -> CalibratedLog:
    """The calibration of one robot from all of its logs together.

    Raises:
        LogError: a log cannot be read, or lacks a topic.
        SlamError: the transforms of a log contradict one another.
    """
    if not paths:
        raise InputDataError("no log to calibrate from; give at least one")
    surveyed, delays = [], []
    with threadpool_limits(1, user_api="blas"):
        for path in paths:
            with LogReader(path, config.reading_limits) as reader:
                log, logged_after, _ = _survey(reader, _open(reader, config, topics, ()), MAX_DETECTIONS // len(paths))
                surveyed.append(log)
                delays.append(logged_after)
        found = calibrate(config, survey(surveyed, config.calibration), delays[0])
    # What kept its default is known now, too.
    known = Calibration.model_validate(found.config.calibration.model_dump(exclude_none=True))
    return replace(found, config=found.config.model_copy(update={"calibration": known}))


def _open(reader: LogReader, config: Config, topics: Mapping[str, str] | None, copy: Collection[str]) -> PreparedLog:
    """The log with the calibration that was given."""
    selection = select_topics(reader.topics(), {**config.topics, **(topics or {})})
    copied = _copied_topics(reader, selection, copy)
    used = {topic: kinds for topic, kinds in selection.kinds.items() if set(kinds) & set(_MAPPED)}
    mapped = Selection(used, selection.mappings)
    infos = [info for info in reader.topics() if info.topic in mapped.topics]
    ends = [ns for info in infos for ns in (info.first_log_time_ns, info.last_log_time_ns) if ns is not None]
    # Where the sensors are is read beforehand: between two transforms only when the later one is known, too.
    frames = SensorFrames()
    for entry in reader.records(mapped.only(RecordKind.TRANSFORMS)):
        if isinstance(entry.record, Transform):
            frames.add(entry.record)
    labels = LabelMap(config.labels)
    return PreparedLog(
        selection,
        mapped.without(RecordKind.TRANSFORMS),
        copied,
        min(ends, default=0),
        max(ends, default=0),
        labels,
        frames,
        ScanObjects(labels, frames),
        CalibratedLog(config),
        NO_DRIFT,
        reader.decoding_counters,
    )


def _copied_topics(reader: LogReader, selection: Selection, wanted: Collection[str]) -> frozenset[str]:
    """The topics that are copied to the output: those for an evaluation, and those in ``wanted``.

    Raises:
        TopicSelectionError: the log lacks one of these, or the output has a topic of that name.
    """
    copied = {topic for kind in _COPIED for topic in selection.topics_of(kind)}
    copied |= set(selection.topics_of(RecordKind.TRANSFORMS)) - {FRAMES}
    there = {info.topic for info in reader.topics()}
    for topic in wanted:
        if topic == FRAMES or topic.startswith(OUTPUT_PREFIX):
            raise TopicSelectionError(f"{topic} cannot be copied: the output already has a topic of that name")
        if topic not in there:
            raise TopicSelectionError(f"the log has no topic {topic} to copy; it has {', '.join(sorted(there))}")
    return frozenset(copied.union(wanted))


def _survey(reader: LogReader, log: PreparedLog, max_detections: int) -> tuple[SurveyedLog, LoggingDelays, ClockDrift]:
    """The beginning of a log by clocks that are corrected for the drift that its log times show, how long after their
    stamps messages were logged, and that drift.
    """
    inputs, drift = log.inputs(), NO_DRIFT
    while True:
        clocks = StampClocks(drift)
        items = reader.items(log.mapped)
        records = inputs.prepare(record for item in items for record in clocks.follow(item))
        surveyed = SurveyedLog(records, log.frames, max_detections=max_detections)
        if drift.rate or not (drift := clocks.drift()).rate:
            return surveyed, clocks.delays(), drift
