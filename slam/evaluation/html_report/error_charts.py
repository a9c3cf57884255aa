"""The error of the trajectory along the path."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam.common.arrays import FloatArray
from slam.common.errors import EvaluationError
from slam.common.geometry import apply, travelled_m
from slam.evaluation.html_report.chart import Chart, Trace, axis, plain_numbers, thin_rows
from slam.evaluation.inputs.records import EvaluationRecords
from slam.evaluation.inputs.synchronization import PoseSeries, clean_poses, synchronize
from slam.evaluation.metrics.trajectory import TrajectoryErrors
from slam.evaluation.result import Evaluation


@dataclass(frozen=True, slots=True, eq=False)
class PositionErrors:
    """Of a trajectory: positions (N, 3) in the map frame, distances (N,) m from the truth, true travel (N,) m."""

    positions: FloatArray
    error_m: FloatArray
    travel_m: FloatArray


def measure_errors(records: EvaluationRecords, evaluation: Evaluation) -> PositionErrors | None:
    """Of the final trajectory, aligned as a whole; None where it has no truth."""
    final = records.trajectory
    estimate = clean_poses(final.stamps_ns, final.T_map_body) if final else _series([])
    return _measure(estimate, _truth(records), evaluation.estimate, evaluation.protocol.max_truth_gap_s)


def draw_error_along_path(records: EvaluationRecords, evaluation: Evaluation) -> Chart | None:
    """Distance between aligned and true position over the true path; None where no trajectory has a truth."""
    truth = _truth(records)
    final = records.trajectory
    estimate = clean_poses(final.stamps_ns, final.T_map_body) if final else _series([])
    odometry = _series([(r.stamp_ns, r.T_odom_body) for r in records.odometry])
    online = _series([(r.stamp_ns, r.T_map_body) for r in records.online_poses])
    gap_s = evaluation.protocol.max_truth_gap_s
    traces = [
        *_draw(odometry, truth, evaluation.odometry, gap_s, "odometry", "--odometry", 1.5),
        *_draw(online, truth, evaluation.online, gap_s, "estimate at its time", "--online", 1.2),
        *_draw(estimate, truth, evaluation.estimate, gap_s, "estimate", "--estimate", 2.2),
    ]
    if not traces:
        return None
    layout = {
        "xaxis": axis("true path travelled [m]", rangemode="tozero"),
        "yaxis": axis("position error [m]", rangemode="tozero"),
        "hovermode": "x unified",
    }
    return Chart("error", "Position error along the path: " + ", ".join(t["name"] for t in traces), traces, layout)


def _draw(
    path: PoseSeries,
    truth: PoseSeries,
    errors: TrajectoryErrors | None,
    max_gap_s: float,
    name: str,
    color: str,
    width: float,
) -> list[Trace]:
    measured = _measure(path, truth, errors, max_gap_s)
    if measured is None or errors is None:
        return []
    rows = thin_rows(len(measured.error_m), 1500)
    return [
        {
            "type": "scatter",
            "mode": "lines",
            "name": f"{name} (RMSE {errors.absolute.rmse_m:.2f} m)",
            "x": plain_numbers(measured.travel_m[rows], 1),
            "y": plain_numbers(measured.error_m[rows], 3),
            "line": {"color": color, "width": width},
            "hovertemplate": f"%{{y:.2f}} m<extra>{name}</extra>",
        }
    ]


def _measure(
    path: PoseSeries, truth: PoseSeries, errors: TrajectoryErrors | None, max_gap_s: float
) -> PositionErrors | None:
    if errors is None:
        return None
    try:
        poses = synchronize(path, truth, max_gap_s=max_gap_s)
    except EvaluationError:
        return None
    aligned = apply(errors.alignment.T_world_map, poses.positions_est)
    error_m = np.linalg.norm(aligned - poses.positions_gt, axis=1)
    return PositionErrors(poses.positions_est, error_m, travelled_m(poses.T_world_body_gt))


def _truth(records: EvaluationRecords) -> PoseSeries:
    return _series([(r.stamp_ns, r.T_world_body) for r in records.true_poses])


def _series(stamped_poses: list[tuple[int, np.ndarray]]) -> PoseSeries:
    stamps_ns = np.array([stamp for stamp, _ in stamped_poses], dtype=np.int64)
    return clean_poses(stamps_ns, np.array([T for _, T in stamped_poses], dtype=np.float64).reshape(-1, 4, 4))
