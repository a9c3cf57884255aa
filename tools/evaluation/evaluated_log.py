"""One log of a replay, read and evaluated."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from slam.common.arrays import FloatArray
    from slam.evaluation.inputs.records import EvaluationRecords
    from slam.evaluation.inputs.text_reference import TextReference
    from slam.evaluation.result import Evaluation


@dataclass(frozen=True, slots=True)
class Truth:
    """The ground truth, if the logs do not hold it, and how it is used.

    ``reference``: the log, or the file of poses, that holds the truth; ``times`` and ``calib``: of poses in KITTI's
    format; ``topics``: by kind; ``map_run``: the drive that made the map in which the robot found itself;
    ``thresholds``: of the protocol, by name, that are not its own.
    """

    reference: Path | None = None
    times: Path | None = None
    calib: Path | None = None
    topics: Mapping[str, str] | None = None
    map_run: Path | None = None
    thresholds: Mapping[str, float] = field(default_factory=dict)

    def of(self, path: Path | None) -> Path | TextReference | None:
        """The reference at ``path``: a log, or a file of poses with its stamps and calibration."""
        from logs.storage.opening import is_log
        from slam.evaluation.inputs.text_reference import TextReference

        return path if path is None or is_log(path) else TextReference(path, self.times, self.calib)


def evaluate_log(log: Path, truth: Truth) -> tuple[EvaluationRecords, Evaluation]:
    """The records of the log and their evaluation.

    Raises:
        LogError: it cannot be read.
        EvaluationError: it holds no estimate.
    """
    from slam.common.errors import EvaluationError
    from slam.evaluation.evaluate import evaluate, protocol_of
    from slam.evaluation.inputs.records import read_records

    records = read_records(log, reference=truth.of(truth.reference), topics=truth.topics)
    map_alignment = None if truth.map_run is None else _locate_map_of(truth.map_run)
    if records.trajectory is None and not records.online_poses:
        raise EvaluationError(f"{log} holds no estimate (no topics under /slam); give a log that 'dslam replay' wrote")
    return records, evaluate(
        records, protocol_of(records).with_thresholds(truth.thresholds), map_alignment=map_alignment
    )


@cache
def _locate_map_of(log: Path) -> FloatArray:
    """``T_world_map`` (4, 4) of the map that the drive in ``log`` made.

    Raises:
        LogError: it cannot be read.
        EvaluationError: it has no trajectory or no truth.
    """
    from slam.common.errors import EvaluationError
    from slam.evaluation.inputs.records import read_records
    from slam.evaluation.metrics.relocalization import locate_map

    try:
        return locate_map(read_records(log))
    except EvaluationError as error:
        raise EvaluationError(f"--map-run {log}: {error}") from error
