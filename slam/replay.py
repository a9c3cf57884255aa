"""Replay: reader -> Slam -> writer, in one pass over the log."""

import json
import time
from collections import Counter
from collections.abc import Callable, Collection, Mapping
from dataclasses import asdict
from pathlib import Path

from threadpoolctl import threadpool_limits

from logs.errors import LogError, UnwritableLogError
from logs.reader import LogReader
from logs.records import frozen
from logs.storage.placement import partial_path
from logs.storage.regular_file import AnyPath
from logs.writer import LogWriter
from slam.common.config import Config
from slam.common.errors import InputDataError, SavedMapError, SlamError
from slam.final_map import FinalMap
from slam.frontend.input.stamp_clocks import StampClocks
from slam.live_slam import LiveSlam
from slam.localization.gnss import find_georeference
from slam.localization.prior_map import PriorMap
from slam.localization.unrecognised_map import why_doubtful, why_not_recognised
from slam.log_mapper import LogMapper, OutputLog
from slam.object_map.map_io import METADATA
from slam.place_recognition.initial_pose import InitialPose
from slam.prepared_log import prepare_log
from slam.provenance import settings_of
from slam.trajectory_check.judgement import TrajectoryCheck

DEFAULTS = Config()


@frozen
class ReplaySummary:
    """How a replay went. Times are of this machine and go into no output log.

    ``relocalization_times_s``, ``relocalization_distances_m``: time and travel of each relocalization since the start.
    ``tracked_ratio``: share of the odometry messages with a pose in the map when they came. ``trajectory_check``:
    whether the final trajectory is the best of the drive.
    """

    counters: dict[str, int]
    log_s: float
    wall_s: float
    final_status: str
    notes: tuple[str, ...]
    relocalization_times_s: tuple[float, ...]
    relocalization_distances_m: tuple[float, ...]
    tracked_ratio: float
    trajectory_check: TrajectoryCheck


def replay(
    source: AnyPath,
    output: AnyPath,
    config: Config = DEFAULTS,
    *,
    topics: Mapping[str, str] | None = None,
    prior_map: PriorMap | None = None,
    initial_pose: InitialPose | None = None,
    extend: bool = True,
    online: bool = False,
    map_path: AnyPath | None = None,
    copy: Collection[str] = (),
    progress: Callable[[float], None] | None = None,
) -> ReplaySummary:
    """Map the log ``source`` into the log ``output``.

    Args:
        source: any log with odometry and detections.
        output: replaced if it is there; written as NAME.part and renamed when finished.
        config: the effective configuration, which is written into the output.
        topics: kind -> topic, where the log leaves a choice.
        prior_map: a map to localize in.
        initial_pose: where in it the robot starts.
        extend: go on from that map and improve it; else it stays as it is.
        online: calibrate the robot during the drive, by what it has seen so far, as a live robot is, instead of by the
            whole log before it.
        map_path: where to save the map, for later drives.
        copy: further topics of the input, for example of cameras, that go into the output as they are.
        progress: called with the fraction done, in [0, 1].

    Raises:
        LogError: the input cannot be read or the output cannot be written.
        SlamError: the input cannot be mapped, or the robot was not relocalized in the prior map and none is saved.
    """
    if map_path is not None and prior_map is not None and not extend:
        raise SavedMapError(
            f"the given map does not change, so {map_path} would be a copy of it; extend the map, or do not save it"
        )
    started = time.perf_counter()
    source, output = Path(source), Path(output)
    # One thread: the products are small, and threads would add them up in another order on another machine.
    with threadpool_limits(1, user_api="blas"), LogReader(source, config.reading_limits) as reader:
        _check_drive(reader, source, output)
        prepared = prepare_log(reader, config, topics=topics, copy=copy, is_surveyed=not online)
        clocks = StampClocks(prepared.drift)
        slam = LiveSlam(
            prepared.calibration.config.model_copy(update={"calibrate": online and config.calibrate}),
            prior_map,
            extend=extend,
            initial_pose=initial_pose,
            frames=prepared.frames,
            delays=clocks.delays,
        )
        with LogWriter(output, refusals=(LogError, SlamError)) as writer:
            georeference = None if prior_map is None else prior_map.georeference
            mapper = LogMapper(slam, prepared.inputs(), clocks, OutputLog([writer.write], georeference))
            for item in reader.items(prepared.mapped, copy=prepared.copied):
                if item.raw.topic in prepared.copied:
                    writer.write_raw(item.raw)
                mapper.process(item, item.raw.log_time_ns)
                if progress is not None:
                    done = (item.raw.log_time_ns - prepared.first_ns) / max(prepared.last_ns - prepared.first_ns, 1)
                    progress(min(max(done, 0.0), 1.0))
            final = mapper.finish(prepared.last_ns, Counter(reader.counters) + Counter(prepared.lost))
            calibration = slam.calibration if online else prepared.calibration
            provenance = settings_of(config, calibration, prior_map, extend=extend) | {
                "input_sha256": reader.sha256(),
                "topics": json.dumps({topic: list(used) for topic, used in sorted(prepared.selection.kinds.items())}),
                "trajectory_check": json.dumps(asdict(final.trajectory_check)),
            }
            writer.add_metadata("dslam", provenance)
            if prior_map is None:
                georeference = find_georeference(final.trajectory, mapper.fixes)
            if georeference is not None:
                writer.add_metadata("dslam_georeference", {"georeference": georeference.to_json()})
            mapper.log.write_final(final, prepared.last_ns)
        if map_path is not None:
            try:
                slam.save(map_path, final, provenance)
            except (SavedMapError, UnwritableLogError) as error:
                error.add_note(f"{output} is complete")
                raise
    notes = (
        *calibration.notes,
        *([str(prepared.drift)] if prepared.drift.rate else []),
        *map(str, clocks.steps),
        *_about_the_map(mapper, prior_map, final, config),
        *prepared.labels.notes(),
    )
    counters, fixes, start_ns = dict(final.status.counters), slam.fixes, int(final.trajectory.stamps_ns[0])
    return ReplaySummary(
        counters=counters,
        log_s=(prepared.last_ns - prepared.first_ns) * 1e-9,
        wall_s=time.perf_counter() - started,
        final_status=final.status.message,
        notes=notes,
        relocalization_times_s=tuple((fix.stamp_ns - start_ns) * 1e-9 for fix in fixes),
        relocalization_distances_m=tuple(fix.travel_m for fix in fixes),
        tracked_ratio=mapper.log.tracked / max(counters.get("odometry_used", 0), 1),
        trajectory_check=final.trajectory_check,
    )


def _check_drive(reader: LogReader, source: Path, output: Path) -> None:
    """Raises: UnwritableLogError: the output would replace the input; InputDataError: the input is a map."""
    for path in (output, partial_path(output)):
        if path.exists() and any(path.samefile(file) for file in reader.files):
            raise UnwritableLogError(f"writing {output} would overwrite the input {source}; give another output")
    if METADATA in reader.metadata():
        raise InputDataError(f"{source} is a saved map, not a drive; give it as --map, and the log of a drive here")


def _about_the_map(mapper: LogMapper, prior_map: PriorMap | None, final: FinalMap, config: Config) -> list[str]:
    """What explains that the robot was not found in its map, or says that it was found at a wrong place."""
    if prior_map is None:
        return []
    sigma_m = config.calibration.objects.landmark_sigma_m
    if mapper.slam.fixes:
        doubt = why_doubtful(prior_map, final.object_map, final.trajectory, sigma_m)
        return [f"probably relocalized at a wrong place: {doubt}"] if doubt else []
    reason = why_not_recognised(prior_map, final.object_map, final.trajectory, sigma_m, mapper.fixes)
    return [f"not relocalized, probably because: {reason}"]
