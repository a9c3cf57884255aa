"""One log of a replay, read and evaluated."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from slam.common.arrays import FloatArray
    from slam.evaluation.inputs.records import EvaluationRecords
    from slam.evaluation.result import Evaluation


@dataclass(frozen=True, slots=True)
class Truth:
    """What the logs are compared with, if it is not in themselves.

    ``reference``: the log that holds the truth; ``topics``: by kind; ``map_alignment``: ``T_world_map`` (4, 4) of the
    map in which the robot found itself.
    """

    reference: Path | None = None
    topics: Mapping[str, str] | None = None
    map_alignment: FloatArray | None = None


def evaluate_log(log: Path, truth: Truth) -> tuple[EvaluationRecords, Evaluation]:
    """What was read of the log, and what was measured.

    Raises:
        LogError: it cannot be read.
        EvaluationError: it holds no estimate.
    """
    from slam.common.errors import EvaluationError
    from slam.evaluation.evaluate import evaluate
    from slam.evaluation.inputs.records import read_records

    records = read_records(log, reference=truth.reference, topics=truth.topics)
    if records.trajectory is None and not records.online_poses:
        raise EvaluationError(f"{log} holds no estimate (no topics under /slam); give a log that 'dslam replay' wrote")
    return records, evaluate(records, map_alignment=truth.map_alignment)


def locate_map_of(log: Path) -> FloatArray:
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
