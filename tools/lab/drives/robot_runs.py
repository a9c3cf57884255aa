"""One drive after the other: imported, mapped in a process of its own, and evaluated."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from logs.errors import LogError
from logs.importers.text_log import import_text_log
from slam.common.config import Config
from slam.common.errors import InputDataError, SlamError
from slam.evaluation.evaluate import evaluate
from slam.evaluation.inputs.records import read_records
from tools.lab.drives.replay import measure_replay
from tools.lab.drives.robot_drives import RobotDrive


@dataclass(frozen=True, slots=True)
class RobotFigures:
    """What mapping made of a drive; None where the drive or its truth leaves a figure undefined.

    ``odometry_ate_m``, ``ate_m``: RMSE of the positions, aligned by SE(3), of the odometry and of the final trajectory.
    ``object_count``: true objects that were detected; ``associations_precision``: share of the assignments to a
    landmark that show its object; closures as :class:`slam.evaluation.place_recognition.closures.ClosureQuality` has
    them; ``discoveries_independent`` of them have no object in common, and no more than ``discoveries_false_share`` are
    false, with 95 % confidence. ``final_status``: what the replay said last. Times and memory are those of the replay
    alone.
    """

    odometry_ate_m: float | None
    ate_m: float | None
    landmarks_confirmed: int
    object_count: int | None
    associations_precision: float | None
    closures_accepted: int | None
    closures_precision: float | None
    discoveries_independent: int | None
    discoveries_false_share: float | None
    revisit_recall: float | None
    revisits_recognised: float | None
    log_s: float
    wall_s: float
    peak_memory_bytes: int
    counters: Mapping[str, int]
    final_status: str

    @property
    def real_time_factor(self) -> float:
        """How many times faster than the drive took it was mapped."""
        return self.log_s / self.wall_s


@dataclass(frozen=True, slots=True)
class RobotRun:
    """A drive with its figures, or with the reason why there are none."""

    drive: str
    figures: RobotFigures | None
    failure: str = ""


def run_drives(drives: Sequence[RobotDrive], config: Config) -> Iterator[RobotRun]:
    """Run each drive; one that fails is reported and does not end the others."""
    for drive in drives:
        try:
            with TemporaryDirectory() as folder:
                yield RobotRun(drive.name, _run(drive, Path(folder), config))
        except (LogError, SlamError) as error:
            yield RobotRun(drive.name, None, str(error))


def _run(drive: RobotDrive, folder: Path, config: Config) -> RobotFigures:
    if drive.detections is None:
        raise InputDataError(f"{drive.odometry.parent}: no file detections.*, so there is nothing to map")
    log, output = folder / "drive.mcap", folder / "map.mcap"
    import_text_log(log, odometry=drive.odometry, detections=drive.detections, ground_truth=drive.ground_truth)
    replayed = measure_replay(log, output, config)
    records = read_records(output)
    evaluation = evaluate(records)
    associations, closures = evaluation.associations, evaluation.closures
    revisits = closures.revisits if closures else None
    discoveries = closures.discoveries if closures else None
    return RobotFigures(
        odometry_ate_m=evaluation.odometry.absolute.rmse_m if evaluation.odometry else None,
        ate_m=evaluation.estimate.absolute.rmse_m if evaluation.estimate else None,
        landmarks_confirmed=evaluation.counters.get("landmarks_confirmed", 0),
        object_count=len(associations.object_detection_counts) if associations else None,
        associations_precision=associations.precision if associations else None,
        closures_accepted=closures.accepted_count if closures else None,
        closures_precision=closures.precision if closures else None,
        discoveries_independent=discoveries.independent if discoveries else None,
        discoveries_false_share=discoveries.largest_false_share if discoveries else None,
        revisit_recall=revisits.recall if revisits else None,
        revisits_recognised=revisits.recognised if revisits else None,
        log_s=replayed.log_s,
        wall_s=replayed.wall_s,
        peak_memory_bytes=replayed.peak_memory_bytes,
        counters=evaluation.counters,
        final_status=records.status.message if records.status else "",
    )
