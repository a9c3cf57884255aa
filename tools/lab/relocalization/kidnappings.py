"""Time to relocalization in a map, at places of a drive with truth.

``benchmark_relocalization`` is where to begin reading.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree
from threadpoolctl import threadpool_limits

from logs.messages import ObjectDetections, Record, SlamPose, Transform
from logs.records import frozen
from slam.common.arrays import BoolArray, FloatArray, IntArray
from slam.common.config import Config
from slam.common.errors import EvaluationError
from slam.common.geometry import interpolate, invert, yaw_rad
from slam.evaluation.inputs.protocol import Protocol
from slam.evaluation.inputs.synchronization import PoseSeries, series_of, synchronize
from slam.evaluation.metrics.statistics import percentile
from slam.evaluation.metrics.trajectory import evaluate_trajectory
from slam.localization.prior_map import PriorMap
from slam.object_map.map_io import SavedMap, confirmed
from slam.place_recognition.imported_map import ImportedMap
from slam.system import Slam
from tools.console import progress_bar
from tools.lab.drives.true_drive import DriveRecord, read_true_drive, truth_of

RECOVERED_WITHIN_M = 40.0
"""Travel within which a right fix is a success."""
MAX_TRAVEL_M = 1.5 * RECOVERED_WITHIN_M
"""Length of each search: a right fix may come late."""


@frozen
class KnownMap:
    """A map; ``positions`` (P, 3) m in the world are those of the robot that made it, else of its landmarks.

    ``T_world_map`` (P, 4, 4): where the map is in the world by the truth at each position, the identity for an imported
    map; ``ate_m``: trajectory error of the mapping drive.
    """

    saved: PriorMap
    positions: FloatArray
    T_world_map: FloatArray
    ate_m: float = 0.0


def benchmark_relocalization(
    path: Path, config: Config, *, given: ImportedMap | float, kidnaps: int, topics: Mapping[str, str] | None = None
) -> dict[str, Any]:
    """Relocalize at places of a drive with truth, evenly spread over it.

    Args:
        path: the log.
        config: of the estimator; what it leaves open is estimated from the log.
        given: an imported map in the frame of the truth; or seconds from the beginning of the log, up to which it is
            mapped, and from which on places are taken.
        kidnaps: most places in the map, and most places far from it.
        topics: kind -> topic, where the log leaves a choice.

    Returns:
        ``drive``, ``landmarks`` and ``map_ate_m``; ``everywhere``: :func:`figures` of places in the map; ``outcomes``
        there and, far from the map, where any fix is false, ``elsewhere``.

    Raises:
        LogError: the log cannot be read.
        SlamError: it holds no truth, or no place of it is in the map.
    """
    records, truth, config = read_true_drive(path, config, topics)
    begin_ns = int(truth.stamps_ns[0])
    with threadpool_limits(1), progress_bar("relocalizing") as show_done:
        if isinstance(given, ImportedMap):
            T_world_map = np.broadcast_to(np.eye(4), (len(given.positions), 4, 4))
            known, reach_m = KnownMap(given, given.positions.astype(np.float64), T_world_map), config.sensor_range_m
        else:
            begin_ns += round(1e9 * given)
            known, reach_m = map_drive(_between(records, 0, begin_ns), config), Protocol().revisit_distance_m
        inside, outside = find_starts(known, truth, begin_ns, reach_m, 2.0 * config.sensor_range_m, kidnaps)
        if not len(inside):
            raise EvaluationError(
                f"after {(begin_ns - truth.stamps_ns[0]) * 1e-9:g} s the drive never stays within {reach_m:g} m of the "
                f"map for {RECOVERED_WITHIN_M:g} m; choose another time or map"
            )
        rows, travelled_m, outcomes = np.append(inside, outside), truth.travelled_m, list[dict[str, Any]]()
        ends = np.searchsorted(travelled_m, travelled_m[rows] + MAX_TRAVEL_M).clip(max=len(truth) - 1)
        for first_ns, last_ns in truth.stamps_ns[np.stack([rows, ends], axis=1)].tolist():
            outcomes.append(put_down(known, _between(records, first_ns, last_ns), config))
            show_done(len(outcomes) / len(rows))
    return {
        "drive": path.stem,
        "landmarks": len(known.saved.positions),
        "map_ate_m": known.ate_m,
        "everywhere": figures(pd.DataFrame(outcomes[: len(inside)], dtype=object)),
        "outcomes": outcomes[: len(inside)],
        "elsewhere": outcomes[len(inside) :],
    }


def map_drive(records: Sequence[Record], config: Config) -> KnownMap:
    """Map a drive whose truth is known.

    Raises:
        SlamError: it cannot be mapped, or holds no truth.
    """
    slam = Slam(config)
    for record in records:
        slam.process(record)
    final, truth = slam.finish(), truth_of(records)
    estimate = series_of(zip(final.trajectory.stamps_ns.tolist(), final.trajectory.T_map_body, strict=True))
    est, gt = synchronize(estimate, truth)
    return KnownMap(
        saved=SavedMap(confirmed(final.object_map), final.graph),
        positions=gt.positions,
        T_world_map=gt.T_world_body @ invert(est.T_world_body),
        ate_m=evaluate_trajectory(estimate, truth).ate_m,
    )


def find_starts(
    known: KnownMap, truth: PoseSeries, begin_ns: int, reach_m: float, far_m: float, count: int
) -> tuple[IntArray, IntArray]:
    """Rows of the truth at which drives can begin: where the map is in reach up to a fix, and where it never is; at
    most ``count`` of either, evenly spread.
    """
    travelled_m = truth.travelled_m
    apart_m = np.asarray(cKDTree(known.positions[:, :2]).query(truth.positions[:, :2])[0])
    begins = np.unique(np.searchsorted(travelled_m, np.arange(0.0, travelled_m[-1], Protocol().query_spacing_m)))
    begins = begins[truth.stamps_ns[begins] >= begin_ns]

    def starts(length_m: float, is_wrong: BoolArray) -> IntArray:
        """Where no pose over the next ``length_m`` of travel is wrong."""
        rows = begins[travelled_m[begins] + length_m <= travelled_m[-1]]
        ends = np.searchsorted(travelled_m, travelled_m[rows] + length_m) + 1
        wrong_before = np.append(0, np.cumsum(is_wrong))
        rows = rows[wrong_before[ends] == wrong_before[rows]]
        return rows[np.unique(np.linspace(0, len(rows) - 1, min(count, len(rows))).round().astype(np.int64))]

    return starts(RECOVERED_WITHIN_M, apart_m > reach_m), starts(MAX_TRAVEL_M, apart_m <= far_m)


def put_down(known: KnownMap, records: Sequence[Record], config: Config) -> dict[str, Any]:
    """Drive until the robot is localized in the map.

    Returns:
        ``objects`` in the first scan; ``query_ms``: the searches; and of the first fix, None without, ``distance_m``
        and ``seconds`` from the start, ``error_m`` and ``error_deg`` in the plane and in heading, and ``is_right``.
    """
    truth = truth_of(records)
    slam = Slam(config, known.saved, extend=False)
    updates = (update for record in records for update in slam.process(record))
    fix = next((update for update in updates if isinstance(update, SlamPose)), None)
    outcome: dict[str, Any] = {
        "objects": next((len(each.labels) for each in records if isinstance(each, ObjectDetections)), 0),
        "query_ms": [1e3 * seconds for seconds in slam.closing_seconds],
        **dict.fromkeys(("distance_m", "seconds", "error_m", "error_deg", "is_right")),
    }
    if fix is not None:
        at_ns = np.clip([fix.stamp_ns], truth.stamps_ns[0], truth.stamps_ns[-1])
        T_world_body = interpolate(truth.stamps_ns, truth.T_world_body, at_ns)[0]
        # By the nearest position of the map: its distortion between distant places has no effect.
        nearest = np.argmin(np.linalg.norm(known.positions[:, :2] - T_world_body[:2, 3], axis=1))
        error_m, error_deg = deviation(known.T_world_map[nearest] @ fix.T_map_body, T_world_body)
        outcome |= {
            "distance_m": truth.travelled_at_m(at_ns)[0],
            "seconds": 1e-9 * (fix.stamp_ns - slam.first_stamp_ns),
            "error_m": error_m,
            "error_deg": error_deg,
            "is_right": bool(Protocol().is_true(np.array(error_m), np.deg2rad(error_deg))),
        }
    return outcome


def deviation(T_world_body_est: FloatArray, T_world_body_gt: FloatArray) -> tuple[float, float]:
    """Distance in the plane [m] and difference of heading [deg], both >= 0, of two poses (4, 4)."""
    offset = T_world_body_est[:2, 3] - T_world_body_gt[:2, 3]
    turn_rad = yaw_rad(invert(T_world_body_gt) @ T_world_body_est)
    return float(np.hypot(*offset)), float(abs(np.rad2deg(turn_rad)))


def figures(outcomes: pd.DataFrame) -> dict[str, Any]:
    """Shares, which add up to 1, and percentiles of outcomes, one a row; None where there is nothing to measure.

    Distance and time are those of the right fixes, late ones included; errors those of all fixes.
    """
    is_right, is_wrong = outcomes["is_right"].eq(True), outcomes["is_right"].eq(False)
    is_late, right = is_right & outcomes["distance_m"].gt(RECOVERED_WITHIN_M), outcomes[is_right]
    return {
        "kidnaps": len(outcomes),
        "success_rate": (is_right & ~is_late).mean(),
        "late_rate": is_late.mean(),
        "false_relocalization_rate": is_wrong.mean(),
        "not_found_rate": outcomes["is_right"].isna().mean(),
        "median_distance_m": percentile(right["distance_m"], 50.0),
        "p95_distance_m": percentile(right["distance_m"], 95.0),
        "median_seconds": percentile(right["seconds"], 50.0),
        "median_error_m": percentile(outcomes["error_m"], 50.0),
        "p95_error_m": percentile(outcomes["error_m"], 95.0),
        "median_error_deg": percentile(outcomes["error_deg"], 50.0),
        "query_ms": percentile([ms for each in outcomes["query_ms"] for ms in each], 50.0),
    }


def _between(records: list[DriveRecord], first_ns: int, last_ns: int) -> list[DriveRecord]:
    """The records of a time, and all transforms."""
    return [each for each in records if isinstance(each, Transform) or first_ns <= each.stamp_ns <= last_ns]
