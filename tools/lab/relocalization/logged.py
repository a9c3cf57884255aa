"""How soon a robot finds out where it is, on a real drive: the first part makes the map, the rest searches in it.

``benchmark_log`` is where to begin reading.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree
from threadpoolctl import threadpool_limits

from logs.container.limits import RESULT_LIMITS
from logs.messages import GroundTruthPose, ObjectDetections, Odometry, Record, Transform
from logs.reader import LogReader
from logs.selection import select_topics
from logs.topics import RecordKind
from slam.common.arrays import FloatArray, IntArray
from slam.common.config import Config
from slam.common.errors import EvaluationError
from slam.evaluation.inputs.synchronization import PoseSeries
from tools.lab.relocalization.figures import sum_up
from tools.lab.relocalization.known_map import KnownMap, map_drive, truth_of
from tools.lab.relocalization.trial import RECOVERED_WITHIN_M, Drive, Tolerance, put_down

REVISIT_M = 5.0
"""The robot is where the map has been if the mapped path is that near, all the way that it has for a fix."""
ELSEWHERE_M = 60.0
"""... and where the map has never been if it is farther than any sensor sees, on the whole drive."""
STEP_M = 2.0

_Measured = Odometry | ObjectDetections | GroundTruthPose


def benchmark_log(
    path: Path,
    config: Config,
    *,
    map_until_s: float,
    kidnaps: int,
    max_travel_m: float = 60.0,
    tolerance: Tolerance,
    topics: Mapping[str, str] | None = None,
    on_progress: Callable[[float], None] | None = None,
) -> dict[str, Any]:
    """Map the first part of a drive with truth, and relocalize at places of the rest, evenly spread.

    The figures are of places where the map has been. Where it has not (``elsewhere_...``), any fix is false.

    Args:
        path: the log.
        config: of the estimator.
        map_until_s: the map is made of what was measured up to then, from the beginning of the log.
        kidnaps: most places where the map has been, and most where it has not.
        max_travel_m: length of each search.
        tolerance: of a right fix.
        topics: kind -> topic, where the log leaves a choice.
        on_progress: called with the fraction done, in [0, 1].

    Raises:
        LogError: the log cannot be read.
        SlamError: it holds no truth, or the rest of the drive never comes back to the map.
    """
    records = _read(path, topics)
    truth = truth_of(records)
    if not len(truth.stamps_ns):
        raise EvaluationError(f"{path} holds no ground truth, so no place in it is known; see --topic ground_truth=")
    end_ns = int(truth.stamps_ns[0] + round(1e9 * map_until_s))
    first = [each for each in records if isinstance(each, Transform) or _stamp_ns(each) <= end_ns]
    mapped, elsewhere = _starts(truth, end_ns, max_travel_m)
    if not len(mapped):
        raise EvaluationError(
            f"after {map_until_s:g} s the drive never comes within {REVISIT_M:g} m of what it passed before for "
            f"{RECOVERED_WITHIN_M:g} m, so there is no place of the map to be found at; choose another moment"
        )
    with threadpool_limits(1):
        known = map_drive(first, config)
        chosen = [_spread(mapped, kidnaps), _spread(elsewhere, kidnaps)]
        drives = [_drive(known, records, truth, int(row), max_travel_m) for rows in chosen for row in rows]
        outcomes = list[dict[str, Any]]()
        for drive in drives:
            outcomes.append(put_down(known, drive, config, tolerance))
            if on_progress is not None:
                on_progress(len(outcomes) / len(drives))
    count = len(chosen[0])
    elsewhere_outcomes = outcomes[count:]
    return sum_up(
        outcomes[:count],
        world=path.stem,
        tour_m=float(truth.travelled_at_m(np.array([end_ns]))[0]),
        landmarks=known.landmark_count,
        map_ate_m=known.ate_m,
        elsewhere_kidnaps=len(elsewhere_outcomes),
        elsewhere_fixes=sum(each["distance_m"] is not None for each in elsewhere_outcomes),
        elsewhere_outcomes=elsewhere_outcomes,
    )


def _read(path: Path, topics: Mapping[str, str] | None) -> list[Record]:
    with LogReader(path, RESULT_LIMITS) as reader:
        selection = select_topics(
            reader.topics(), topics, needed=(RecordKind.ODOMETRY, RecordKind.DETECTIONS, RecordKind.GROUND_TRUTH)
        )
        return [entry.record for entry in reader.records(selection) if isinstance(entry.record, _Measured | Transform)]


def _starts(truth: PoseSeries, end_ns: int, max_travel_m: float) -> tuple[IntArray, IntArray]:
    """Rows of the truth at which drives can begin: where the map has been, and where it has not."""
    travelled_m, passed = truth.travelled_m, int(np.searchsorted(truth.stamps_ns, end_ns, side="right"))
    distances_m = np.asarray(cKDTree(truth.positions[:passed]).query(truth.positions)[0])
    begins_m = np.arange(travelled_m[min(passed, len(travelled_m) - 1)], travelled_m[-1], STEP_M)

    def starts(length_m: float, is_start: Callable[[FloatArray], bool]) -> IntArray:
        """Where all distances over the next stretch fulfil a condition."""
        rows = np.unique(np.searchsorted(travelled_m, begins_m[begins_m + length_m <= travelled_m[-1]]))
        ends = np.searchsorted(travelled_m, travelled_m[rows] + length_m) + 1
        return np.array([row for row, end in zip(rows, ends, strict=True) if is_start(distances_m[row:end])], np.int64)

    return (
        starts(RECOVERED_WITHIN_M, lambda apart_m: bool(np.all(apart_m <= REVISIT_M))),
        starts(max_travel_m, lambda apart_m: bool(np.all(apart_m > ELSEWHERE_M))),
    )


def _spread(rows: IntArray, count: int) -> IntArray:
    """At most ``count`` of the rows (R,), evenly."""
    if not len(rows):
        return rows
    return np.unique(rows[np.linspace(0, len(rows) - 1, min(count, len(rows))).round().astype(np.int64)])


def _drive(known: KnownMap, records: list[Record], truth: PoseSeries, row: int, max_travel_m: float) -> Drive:
    travelled_m = truth.travelled_m
    last = min(int(np.searchsorted(travelled_m, travelled_m[row] + max_travel_m)), len(travelled_m) - 1)
    first_ns, last_ns = int(truth.stamps_ns[row]), int(truth.stamps_ns[last])
    perceived = [each for each in records if isinstance(each, Transform) or first_ns <= _stamp_ns(each) <= last_ns]
    T_world_body = truth.T_world_body[row]
    nearest = int(np.argmin(np.linalg.norm(known.T_world_body_gt[:, :2, 3] - T_world_body[:2, 3], axis=1)))
    is_along = float(known.T_world_body_gt[nearest, :2, 0] @ T_world_body[:2, 0]) >= 0.0
    objects = next((len(each.labels) for each in perceived if isinstance(each, ObjectDetections)), 0)
    return Drive(row, float(travelled_m[row]), is_along, objects, tuple(perceived))


def _stamp_ns(record: Record) -> int:
    return record.stamp_ns
