"""Replay: reader -> Slam -> writer, in one pass over the log."""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from logs.errors import TopicSelectionError, UnwritableLogError
from logs.messages import (
    GeodeticFix,
    GroundTruthPose,
    Record,
    Transform,
)
from logs.reader import LogReader
from logs.selection import OUTPUT_PREFIX, Selection, select_topics
from logs.topics import RecordKind
from logs.writer import LogWriter, partial_path
from slam.common.config import Config
from slam.common.config_tree import CHANGED_SETTINGS, changed_settings
from slam.common.errors import InputDataError, SavedMapError
from slam.common.georeference import Georeference
from slam.display.drive_display import FRAMES, DriveDisplay
from slam.final_map import FinalMap
from slam.frontend.input.input_records import InputRecords
from slam.frontend.input.label_map import LabelMap
from slam.frontend.input.scan_objects import ScanObjects
from slam.frontend.input.sensor_frames import SensorFrames
from slam.frontend.input.stamp_clocks import NO_DRIFT, ClockDrift, StampClocks
from slam.localization.gnss import find_georeference
from slam.localization.prior_map import PriorMap
from slam.localization.unrecognised_map import why_not_recognised
from slam.object_map.map_io import METADATA, save_map
from slam.output_log import OutputLog
from slam.place_recognition.imported_map import ImportedMap
from slam.place_recognition.place_prior import PlacePrior
from slam.self_calibration.calibration import Calibration, calibrate
from slam.self_calibration.survey import Survey, survey
from slam.system import Slam

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

DEFAULTS = Config()


@dataclass(frozen=True, slots=True, eq=False)
class ReplaySummary:
    """How a replay went. Times are of this machine and go into no output log.

    ``max_message_latency_s``: longest processing time of one message; ``solver_s``: time inside GTSAM;
    ``loop_closure_median_s``: time of loop closing at a keyframe. ``relocalization_times_s``,
    ``relocalization_distances_m``: time and travel of each relocalization since the start. ``keyframes_not_saved``:
    those that only a discontinuity connects to the saved map, which are left out of it. ``tracked_ratio``: share of the
    odometry messages with a pose in the map when they came.
    """

    counters: dict[str, int]
    log_s: float
    wall_s: float
    solver_s: float
    max_message_latency_s: float
    loop_closure_median_s: float
    final_status: str
    notes: tuple[str, ...] = ()
    relocalization_times_s: tuple[float, ...] = ()
    relocalization_distances_m: tuple[float, ...] = ()
    keyframes_not_saved: int = 0
    tracked_ratio: float = 0.0


def replay(
    source: Path,
    output: Path,
    config: Config = DEFAULTS,
    *,
    topics: Mapping[str, str] | None = None,
    prior_map: PriorMap | None = None,
    place_prior: PlacePrior | None = None,
    extend: bool = True,
    map_path: Path | None = None,
    copy: Collection[str] = (),
    view: Callable[[str, Record, int], None] | None = None,
    progress: Callable[[float], None] | None = None,
) -> ReplaySummary:
    """Map the log ``source`` into the log ``output``.

    Args:
        source: any log with odometry and detections.
        output: replaced if it is there; written as NAME.part and renamed when finished.
        config: the effective configuration, which is written into the output.
        topics: kind -> topic, where the log leaves a choice.
        prior_map: a map to localize in.
        place_prior: where in it the robot starts.
        extend: go on from that map and improve it; else it stays as it is.
        map_path: where to save the map, for later drives.
        copy: further topics of the input, for example of cameras, that go into the output as they are.
        view: called with topic, record and log time of all that is written, while the drive is mapped.
        progress: called with the fraction done, in [0, 1].

    Raises:
        LogError: the input cannot be read or the output cannot be written.
        SlamError: the input cannot be mapped, or the robot was not relocalized in the prior map and none is saved.
    """
    if map_path is not None and prior_map is not None and not extend:
        raise SavedMapError(
            f"the given map stays as it is, so {map_path} would be a copy of it; extend it, or save none"
        )
    started = time.perf_counter()
    labels = LabelMap(config.labels)
    with LogReader(source, config.limits.reading) as reader:
        _check_drive(reader, source, output)
        selection = select_topics(reader.topics(), {**config.topics, **(topics or {})})
        copied = _copied_topics(reader, selection, copy)
        mapped = Selection({topic: kinds for topic, kinds in selection.kinds.items() if set(kinds) & set(_MAPPED)})
        first_ns, last_ns = _span(reader, mapped)
        # Where the sensors are is read beforehand: between two transforms only when the later one is known, too.
        frames = _read_frames(reader, mapped)
        lost_before = reader.decoding_counters
        mapped = mapped.without(RecordKind.TRANSFORMS)
        scans = ScanObjects(labels, frames)
        calibration, drift = _calibrate(reader, mapped, config, InputRecords(config, labels, frames, scans), frames)
        slam = Slam(calibration.config, prior_map, extend=extend, place_prior=place_prior, frames=frames)
        display = DriveDisplay(calibration.config.detection.sensor_range_m, _ground_truth(source, config, selection))
        inputs = InputRecords(calibration.config, labels, frames, scans)
        georeference = _georeference_of(prior_map)
        # One thread: the products are small, and threads would add them up in another order on another machine.
        with threadpool_limits(1, user_api="blas"), LogWriter(output) as writer:
            provenance = (
                _provenance(reader, config, selection)
                | _about_calibration(calibration)
                | _about_map(prior_map, extend=extend)
            )
            writer.add_metadata("dslam", provenance)
            log = OutputLog(writer, display, view, georeference)
            drive = _Drive(slam, inputs, log, fixes=[])
            clocks = StampClocks(drift, keeps_delays=False)
            for item in reader.items(mapped, copy=copied):
                if item.raw.topic in copied:
                    writer.write_raw(item.raw)
                drive.take(list(clocks.follow(item)), item.raw.log_time_ns)
                if progress is not None:
                    done = (item.raw.log_time_ns - first_ns) / max(last_ns - first_ns, 1)
                    progress(min(max(done, 0.0), 1.0))
            drive.take(list(clocks.finish()), last_ns)
            inputs.check()
            slam.counters.update(Counter(reader.counters) + lost_before + Counter(inputs.counters))
            final = slam.finish()
            if georeference is None and prior_map is None:
                georeference = find_georeference(final.trajectory, drive.fixes)
            log.write_final(final, georeference, last_ns)
        unsaved = 0 if map_path is None else _save(map_path, output, slam, final, provenance, prior_map)
    return ReplaySummary(
        counters=dict(final.status.counters),
        log_s=(last_ns - first_ns) * 1e-9,
        wall_s=time.perf_counter() - started,
        solver_s=slam.solver_seconds,
        max_message_latency_s=drive.max_message_latency_s,
        loop_closure_median_s=float(np.median(slam.closing_seconds)) if slam.closing_seconds else 0.0,
        final_status=final.status.message,
        notes=(
            *calibration.notes,
            *([str(drift)] if drift.rate else []),
            *map(str, clocks.steps),
            *_about_the_map(slam, prior_map, final, drive.fixes, config),
            *_about_labels(labels),
        ),
        relocalization_times_s=tuple((fix.stamp_ns - slam.first_stamp_ns) * 1e-9 for fix in slam.fixes),
        relocalization_distances_m=tuple(fix.travel_m for fix in slam.fixes),
        keyframes_not_saved=unsaved,
        tracked_ratio=log.tracked / max(final.status.counters.get("odometry_used", 0), 1),
    )


@dataclass(slots=True)
class _Drive:
    """Takes a log in, message by message; ``fixes``: those of a satellite receiver."""

    slam: Slam
    inputs: InputRecords
    log: OutputLog
    fixes: list[GeodeticFix]
    max_message_latency_s: float = 0.0

    def take(self, records: Sequence[Record], log_time_ns: int) -> None:
        """Map what was logged, and write what that makes known."""
        before = time.perf_counter()
        self.fixes += [record for record in records if isinstance(record, GeodeticFix)]
        for record in self.inputs.prepare(records):
            self.log.write_updates(self.slam.process(record), log_time_ns)
            if (snapshot := self.slam.snapshot()) is not None:
                self.log.write_snapshot(snapshot, log_time_ns)
        self.max_message_latency_s = max(self.max_message_latency_s, time.perf_counter() - before)


def _check_drive(reader: LogReader, source: Path, output: Path) -> None:
    """Raises: UnwritableLogError: the output would replace the input; InputDataError: the input is a map."""
    for path in (output, partial_path(output)):
        if path.exists() and any(path.samefile(file) for file in reader.files):
            raise UnwritableLogError(f"writing {output} would overwrite the input {source}; give another output")
    if METADATA in reader.metadata():
        raise InputDataError(f"{source} is a saved map, not a drive; give it as --map, and the log of a drive here")


def _save(
    map_path: Path, output: Path, slam: Slam, final: FinalMap, provenance: dict[str, str], prior_map: PriorMap | None
) -> int:
    """Save the map of a drive; returns how many keyframes only a discontinuity connects to it."""
    if prior_map is not None and not slam.fixes:
        raise SavedMapError(
            f"the given map was never recognised, so {map_path} would hold two places laid over each other and was "
            f"not written; {output} is complete"
        )
    earlier_drives = None if prior_map is None else prior_map.drives
    try:
        return save_map(
            map_path, final.object_map, final.graph, final.markers, provenance, earlier_drives=earlier_drives
        )
    except (SavedMapError, UnwritableLogError) as error:
        error.add_note(f"{output} is complete")
        raise


def _about_labels(labels: LabelMap) -> list[str]:
    """What of the table of labels did not fit the log."""
    return [
        *(f"no detection has the class of {name}" for name in labels.unused()),
        *(f"the class {name} is taken for {to}: they differ in case only" for name, to in labels.respelled().items()),
    ]


def _georeference_of(prior_map: PriorMap | None) -> Georeference | None:
    return prior_map.georeference if isinstance(prior_map, ImportedMap) else None


def _about_the_map(
    slam: Slam, prior_map: PriorMap | None, final: FinalMap, fixes: Sequence[GeodeticFix], config: Config
) -> list[str]:
    """What explains that the robot was not found in its map."""
    if prior_map is None or slam.fixes:
        return []
    sigma_m = config.submap.landmark_sigma_m
    reason = why_not_recognised(prior_map, final.object_map, final.trajectory, sigma_m, fixes)
    return [f"not recognised, probably because: {reason}"]


def _copied_topics(reader: LogReader, selection: Selection, wanted: Collection[str]) -> set[str]:
    """What goes into the output as it is: what an evaluation needs, and what is ``wanted``."""
    copied = {topic for kind in _COPIED for topic in selection.topics_of(kind)}
    copied |= set(selection.topics_of(RecordKind.TRANSFORMS)) - {FRAMES}
    return copied | _checked_copies(reader, wanted)


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


def _ground_truth(source: Path, config: Config, selection: Selection) -> Iterator[GroundTruthPose]:
    """The true poses of a log; it is opened when the first is asked for."""
    topics = selection.topics_of(RecordKind.GROUND_TRUTH)
    if topics:
        with LogReader(source, config.limits.reading) as reader:
            wanted = Selection(dict.fromkeys(topics, (RecordKind.GROUND_TRUTH,)))
            for entry in reader.records(wanted):
                if isinstance(entry.record, GroundTruthPose):
                    yield entry.record


def _provenance(reader: LogReader, config: Config, selection: Selection) -> dict[str, str]:
    """What made this log: enough to make it again."""
    return {
        "version": version("descriptellation-slam"),
        "configuration": config.model_dump_json(),
        CHANGED_SETTINGS: changed_settings(config),
        "input_sha256": reader.sha256(),
        "topics": json.dumps({topic: list(kinds) for topic, kinds in sorted(selection.kinds.items())}),
    }


def _read_frames(reader: LogReader, selection: Selection) -> SensorFrames:
    frames = SensorFrames()
    for entry in reader.records(selection.only(RecordKind.TRANSFORMS)):
        if isinstance(entry.record, Transform):
            frames.add(entry.record)
    return frames


def _calibrate(
    reader: LogReader, selection: Selection, config: Config, inputs: InputRecords, frames: SensorFrames
) -> tuple[Calibration, ClockDrift]:
    """The settings for a log, of which those that were not given by hand are estimated from it, and how the clock of
    its detections drifts.
    """
    if not config.calibration.enabled:
        return Calibration(config), NO_DRIFT
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
    records = inputs.prepare(record for item in reader.items(selection) for record in clocks.follow(item))
    with threadpool_limits(1, user_api="blas"):
        return survey(records, config.detection, frames, max_classes=config.association.max_classes), clocks


def _about_calibration(calibration: Calibration) -> dict[str, str]:
    """The settings that were estimated from the log, and what that says of the log."""
    return {"estimated": json.dumps(dict(calibration.estimated)), "notes": json.dumps(list(calibration.notes))}


def _about_map(prior_map: PriorMap | None, *, extend: bool) -> dict[str, str]:
    """Which map the drive was given, by the drives that made it."""
    if prior_map is None:
        return {}
    about = {"map_drives": json.dumps([dict(drive) for drive in prior_map.drives]), "map_extended": json.dumps(extend)}
    if prior_map.georeference is not None:  # the output is in the frame of that map
        about["georeference"] = prior_map.georeference.to_json()
    return about


def _span(reader: LogReader, selection: Selection) -> tuple[int, int]:
    """First and last log time [ns] of the selected topics."""
    infos = [info for info in reader.topics() if info.topic in selection.topics]
    first = [info.first_log_time_ns for info in infos if info.first_log_time_ns is not None]
    last = [info.last_log_time_ns for info in infos if info.last_log_time_ns is not None]
    return min(first, default=0), max(last, default=0)
