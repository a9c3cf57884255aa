"""Map, errors, precision and recall, and calibration as charts."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.special import chdtr

from slam.common.arrays import FloatArray
from slam.common.errors import EvaluationError
from slam.common.geometry import apply, travelled_m
from slam.display.map_layers import ESTIMATE, ODOMETRY, TRUE_CLOSURE, Layer, MapPicture, layers_of
from slam.evaluation.inputs.records import EvaluationRecords
from slam.evaluation.inputs.synchronization import PoseSeries, SynchronizedPoses, synchronize
from slam.evaluation.metrics.calibration import Consistency
from slam.evaluation.metrics.trajectory import TrajectoryErrors
from slam.evaluation.page.traces import Chart, Trace, draw_line, draw_points, label, make_axis, make_chart, thin
from slam.evaluation.result import Evaluation

SYMBOLS = {
    "o": "circle",
    "s": "square",
    "^": "triangle-up",
    "v": "triangle-down",
    "<": "triangle-left",
    ">": "triangle-right",
    "D": "diamond",
    "P": "cross",
    "X": "x",
    "h": "hexagon",
    "p": "pentagon",
    "*": "star",
}
"""Markers of matplotlib as plotly names them."""
_CALIBRATED = {"pose": ESTIMATE, "landmark": "#8456c4", "closure": TRUE_CLOSURE}


def draw_map(picture: MapPicture, records: EvaluationRecords, evaluation: Evaluation) -> Chart | None:
    """The drive and its map from above, with the error at each position; None where there is nothing to draw."""
    layers = layers_of(picture)
    shown = sum(len(layer.positions) for layer in layers if layer.size)
    traces = [_draw_layer(layer, shown) for layer in layers]
    under_false_closures = len(layers) - (len(picture.false_closures) > 0)
    traces[under_false_closures:under_false_closures] = _draw_errors(records, evaluation)
    return make_chart(traces, **_view_from_above(picture.points))


def _draw_layer(layer: Layer, shown: int) -> Trace:
    name = label(layer.name) + ("" if layer.count is None else f" ({layer.count})")
    if not layer.size:
        dash = "dash" if layer.is_dashed else "solid"
        return draw_line(layer.positions[:, 0], layer.positions[:, 1], name, layer.color, layer.width, dash=dash)
    rows = thin(np.ones(len(layer.positions), dtype=np.bool_), share=len(layer.positions) / shown)
    texts = [f"<b>{name}</b>"] * len(rows)
    return draw_points(layer.positions[rows], name, texts, layer.color, SYMBOLS[layer.marker], layer.size)


def _view_from_above(points: FloatArray) -> dict[str, Any]:
    """Axes in equal scales for points (N, 3), metres: x to the right, y up."""
    known = points[np.isfinite(points).all(axis=1), :2]
    low, high = (known.min(axis=0), known.max(axis=0)) if len(known) else (np.zeros(2), np.zeros(2))
    margin = max(0.04 * float(np.max(high - low)), 1.0)
    spans = np.round(np.stack([low - margin, high + margin], axis=1), 1).tolist()
    return {
        "x": make_axis("x [m]", range=spans[0]),
        "y": make_axis("y [m]", range=spans[1], scaleanchor="x", scaleratio=1),
        "dragmode": "pan",
        "height": 640,
    }


def _draw_errors(records: EvaluationRecords, evaluation: Evaluation) -> list[Trace]:
    """A dot at each position of the estimate, coloured by its error, with the time."""
    poses = _match_poses(records.final_path, records.true_path, evaluation)
    if evaluation.estimate is None or poses is None:
        return []
    errors_m = _position_errors_m(poses, evaluation.estimate)
    rows = thin(np.ones(len(errors_m), dtype=np.bool_))
    seconds = (poses.stamps_ns[rows] - poses.stamps_ns[0]) * 1e-9
    texts = [f"{s:.1f} s<br>error {error_m:.3f} m" for s, error_m in zip(seconds, errors_m[rows], strict=True)]
    scale = {
        "colorscale": "Viridis",
        "cmin": 0.0,
        "cmax": max(float(np.quantile(errors_m, 0.99)), 1e-3),
        "colorbar": {"title": {"text": "error [m]"}, "len": 0.4, "thickness": 10, "y": 1.0, "yanchor": "top"},
        "line": {"width": 0.0},
    }
    color = np.round(errors_m[rows], 3)
    name = "estimate by its error"
    return [draw_points(poses.positions_est[rows], name, texts, color, size=5, marker=scale, showlegend=False)]


def draw_precision_recall(results: Mapping[str, Any]) -> Chart | None:
    """Precision over recall of every threshold on the score, and that of the run; None without a curve.

    Args:
        results: the evaluation as JSON.
    """
    closures = results["closures"]
    curve = closures["precision_recall_curve"]
    if not curve["recall"]:
        return None
    at = np.array([[closures["recall"], closures["precision"]]], dtype=np.float64)
    text = f"accepted: precision {at[0, 1]:.2%}, recall {at[0, 0]:.2%}"
    name = "every threshold on the score"
    traces = [
        draw_line(np.array(curve["recall"]), np.array(curve["precision"]), name, ESTIMATE),
        draw_points(at, "accepted", [text], ESTIMATE, size=12, cliponaxis=False),
    ]
    share = {"tickformat": ".0%", "rangemode": "tozero"}
    x = make_axis("recall of revisits", range=[0.0, 1.03], **share)
    return make_chart(traces, x, make_axis("precision", range=[0.0, 1.05], **share))


def draw_error_along_path(records: EvaluationRecords, evaluation: Evaluation) -> Chart | None:
    """Distance between aligned and true position over the true path; None where no trajectory has ground truth."""
    traces: list[Trace] = []
    for path, errors, name, color in (
        (records.odometry_path, evaluation.odometry, "odometry", ODOMETRY),
        (records.online_path, evaluation.online, "online estimate", "#64748b"),
        (records.final_path, evaluation.estimate, "estimate", ESTIMATE),
    ):
        poses = _match_poses(path, records.true_path, evaluation)
        if errors is not None and poses is not None:
            title = f"{name} (RMSE {errors.absolute.rmse_m:.3f} m)"
            x, y = travelled_m(poses.T_world_body_gt), _position_errors_m(poses, errors)
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


def _match_poses(path: PoseSeries, truth: PoseSeries, evaluation: Evaluation) -> SynchronizedPoses | None:
    """Poses of a path with their truth; None where there is no truth."""
    try:
        return synchronize(path, truth, max_gap_s=evaluation.protocol.max_truth_gap_s)
    except EvaluationError:
        return None


def _position_errors_m(poses: SynchronizedPoses, errors: TrajectoryErrors) -> FloatArray:
    """Distances (M,) of the poses from the truth after the alignment of the whole trajectory."""
    aligned = apply(errors.alignment.T_world_map, poses.positions_est)
    return np.asarray(np.linalg.norm(aligned - poses.positions_gt, axis=1))
