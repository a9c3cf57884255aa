"""Errors, precision and recall, candidates over time, and calibration as charts."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.special import chdtr

from slam.common.arrays import FloatArray
from slam.common.errors import EvaluationError
from slam.common.geometry import apply, travelled_m
from slam.display import palette
from slam.evaluation.inputs.records import EvaluationRecords
from slam.evaluation.inputs.synchronization import PoseSeries, SynchronizedPoses, synchronize
from slam.evaluation.metrics.calibration import Consistency
from slam.evaluation.metrics.trajectory import TrajectoryErrors
from slam.evaluation.page.traces import Chart, Trace, draw_line, draw_points, make_axis, make_chart
from slam.evaluation.result import Evaluation

_CALIBRATED = {"pose": palette.ESTIMATE, "landmark": "#8456c4", "closure": palette.TRUE_CLOSURE}


def draw_precision_recall(results: Mapping[str, Any]) -> Chart | None:
    """Precision over recall of every threshold on the score, and that of the run; None without a curve.

    Args:
        results: the evaluation as JSON.
    """
    curve = results["closures"]["precision_recall_curve"]
    if not curve["recall"]:
        return None
    recall, precision = np.array(curve["recall"]), np.array(curve["precision"])
    at = np.array([[results["closures"][key] for key in ("recall", "precision")]], dtype=np.float64)
    text = f"accepted: precision {at[0, 1]:.2%}, recall {at[0, 0]:.2%}"
    traces = [
        draw_line(recall, precision, "every threshold on the score", palette.ESTIMATE),
        draw_points(at, "accepted", [text], palette.ESTIMATE, size=12, cliponaxis=False),
    ]
    share = {"tickformat": ".0%", "rangemode": "tozero"}
    x = make_axis("recall of revisits", range=[0.0, 1.03], **share)
    return make_chart(traces, x, make_axis("precision", range=[0.0, 1.05], **share))


def match_poses(path: PoseSeries, truth: PoseSeries, evaluation: Evaluation) -> SynchronizedPoses | None:
    """Poses of a path with their truth; None where there is no truth."""
    try:
        return synchronize(path, truth, max_gap_s=evaluation.protocol.max_truth_gap_s)
    except EvaluationError:
        return None


def position_errors_m(poses: SynchronizedPoses, errors: TrajectoryErrors) -> FloatArray:
    """Distances (M,) of the poses from the truth after the alignment of the whole trajectory."""
    aligned = apply(errors.alignment.T_world_map, poses.positions_est)
    return np.asarray(np.linalg.norm(aligned - poses.positions_gt, axis=1))


def draw_error_along_path(records: EvaluationRecords, evaluation: Evaluation) -> Chart | None:
    """Distance between aligned and true position over the true path; None where no trajectory has ground truth."""
    traces: list[Trace] = []
    for path, errors, name, color in (
        (records.odometry_path, evaluation.odometry, "odometry", palette.ODOMETRY),
        (records.online_path, evaluation.online, "online estimate", "#64748b"),
        (records.final_path, evaluation.estimate, "estimate", palette.ESTIMATE),
    ):
        poses = match_poses(path, records.true_path, evaluation)
        if errors is not None and poses is not None:
            title = f"{name} (RMSE {errors.absolute.rmse_m:.3f} m)"
            x, y = travelled_m(poses.T_world_body_gt), position_errors_m(poses, errors)
            traces.append(draw_line(x, y, title, color) | {"hoverinfo": "y+name"})
    x_axis = make_axis("true path travelled [m]", rangemode="tozero")
    return make_chart(traces, x_axis, make_axis("position error [m]", rangemode="tozero"), hovermode="x unified")


def draw_calibration(parts: Mapping[str, Consistency]) -> Chart | None:
    """Share of the errors within the region of every probability; None where there is no error to compare."""
    if not parts:
        return None
    probabilities = np.linspace(0.0, 1.0, 51)
    traces = [draw_line(probabilities, probabilities, "consistent covariances", "#8a94a3", 1.2, dash="dot")]
    for name, part in parts.items():
        kind = name.removeprefix("planar_")
        within = np.sort(chdtr(part.dimension, part.squares))
        shares = np.searchsorted(within, probabilities, side="right") / part.count
        title = f"{kind}s{' in the plane' if kind != name else ''} (NEES {part.nees:.3f})"
        dash = "dash" if kind != name else "solid"
        traces.append(draw_line(probabilities, shares, title, _CALIBRATED[kind], dash=dash) | {"hoverinfo": "x+y+name"})
    share = {"range": [0.0, 1.04], "tickformat": ".0%"}
    return make_chart(traces, make_axis("probability of the region", **share), make_axis("errors within it", **share))
