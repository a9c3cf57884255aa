"""The drive and its map from above."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from slam.common.arrays import FloatArray
from slam.display import palette
from slam.display.map_picture import MapPicture
from slam.evaluation.inputs.records import EvaluationRecords
from slam.evaluation.inputs.synchronization import PoseSeries
from slam.evaluation.metrics.landmarks import CONFIRMED
from slam.evaluation.page.charts import match_poses, position_errors_m
from slam.evaluation.page.traces import (
    Chart,
    Trace,
    draw_line,
    draw_points,
    label,
    make_chart,
    thin,
    view_from_above,
)
from slam.evaluation.report.picture import closure_ends, estimated_path, positions_at
from slam.evaluation.result import Evaluation

MAX_LANDMARKS = 5000
"""Of more than these every class is thinned alike: a browser draws each as an object of its own."""
TRUTH = "#6b7280"
"""Grey, which is seen on a white and on a dark page."""
SYMBOLS = (
    *("circle", "square", "triangle-up", "diamond", "triangle-down", "cross"),
    *("x", "pentagon", "hexagon", "star", "triangle-left", "triangle-right"),
)


def draw_trajectory(picture: MapPicture, records: EvaluationRecords, evaluation: Evaluation) -> Chart | None:
    """Odometry, estimate by its error, and truth, with closures, missed revisits, and where the robot was lost.

    None where there is no path at all.
    """
    path = estimated_path(records)
    lines = (
        (picture.odometry, "odometry (before)", palette.ODOMETRY, 1.5, "solid"),
        (picture.estimate, "estimate (after)", palette.ESTIMATE, 2.5, "solid"),
        (picture.truth, "ground truth", TRUTH, 1.2, "dash"),
    )
    traces = [
        draw_line(positions[:, 0], positions[:, 1], name, color, width, dash=dash)
        for positions, name, color, width, dash in lines
        if len(positions)
    ]
    if not traces:
        return None
    closures = _draw_closures(evaluation, path)
    for name in ("true", "undecided", "errors", "missed", "false"):  # each covers those before it
        traces += _draw_errors(records, evaluation) if name == "errors" else closures.get(name, [])
    marks = (
        (picture.lost, f"lost ({len(picture.lost)})", palette.LOST, "triangle-down"),
        (picture.found, f"found ({len(picture.found)})", palette.FOUND, "triangle-up"),
        (path.positions[:1], "start", palette.START, "circle"),
        (path.positions[-1:], "end", palette.END, "square"),
    )
    for places, name, color, symbol in marks:
        if len(places):
            texts = [f"<b>{name}</b> at ({x:.1f}, {y:.1f}) m" for x, y in places[:, :2]]
            traces.append(draw_points(places, name, texts, color, symbol, 14))
    return make_chart(traces, **view_from_above(picture.points))


def draw_object_map(picture: MapPicture, records: EvaluationRecords) -> Chart | None:
    """Confirmed landmarks by class over the estimated path; None where there is none."""
    objects = records.object_map
    if objects is None or not len(picture.landmarks):
        return None
    confirmed = [row for row, state in enumerate(objects.states) if state == CONFIRMED]
    path = picture.estimate
    traces = [draw_line(path[:, 0], path[:, 1], "path", "#94a3b8", 1.0, showlegend=False)]
    size = float(np.clip(220.0 / np.sqrt(len(confirmed)), 6.0, 11.0))
    for group in palette.group_classes(picture.labels):
        share = max(MAX_LANDMARKS * len(group.rows) // len(confirmed), 1)
        rows = group.rows[thin(np.ones(len(group.rows), dtype=np.bool_), share)]
        shown = f"{len(rows)}" if len(rows) == len(group.rows) else f"{len(rows)} of {len(group.rows)}"
        texts = [
            f"<b>{label(picture.labels[row])}</b><br>{label(objects.ids[confirmed[row]])}<br>"
            f"{int(objects.observation_counts[confirmed[row]])} measurements"
            for row in rows.tolist()
        ]
        symbol = SYMBOLS[group.index] if group.index >= 0 else "circle"
        name = f"{label(group.name)} ({shown})"
        traces.append(draw_points(picture.landmarks[rows], name, texts, group.color, symbol, size))
    points = np.concatenate([path, picture.landmarks])
    return make_chart(
        traces,
        **view_from_above(points),
    )


def _draw_errors(records: EvaluationRecords, evaluation: Evaluation) -> list[Trace]:
    """A dot at each position of the estimate, coloured by its error, with time and travel."""
    poses = match_poses(records.final_path, records.true_path, evaluation)
    if evaluation.estimate is None or poses is None:
        return []
    errors_m = position_errors_m(poses, evaluation.estimate)
    rows = thin(np.ones(len(errors_m), dtype=np.bool_))
    moments = _describe_moments(records.final_path, poses.stamps_ns[rows])
    texts = [f"{moment}<br>error {error_m:.3f} m" for moment, error_m in zip(moments, errors_m[rows], strict=True)]
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


def _draw_closures(evaluation: Evaluation, path: PoseSeries) -> dict[str, list[Trace]]:
    """Closures by their label, and missed revisits."""
    if evaluation.closures is None:
        return {}
    accepted = evaluation.closures[evaluation.closures["accepted"]]
    true, decided = accepted["true"], accepted["decided"]
    has_truth = evaluation.results["closures"]["true_count"] is not None
    traces = {
        "true": _draw_label(accepted[true], path, "true", palette.TRUE_CLOSURE, "circle", 1.5, always=has_truth),
        "undecided": _draw_label(accepted[~decided], path, "undecided", palette.CLOSURE, "circle", 1.5),
        "false": _draw_label(
            accepted[decided & ~true], path, "false", palette.FALSE_CLOSURE, "x", 3.0, always=has_truth
        ),
    }
    if evaluation.results["closures"]["revisit_count"] is not None:
        at_ns = np.array(evaluation.missed_ns, dtype=np.int64)
        texts = [f"<b>missed revisit</b><br>{moment}" for moment in _describe_moments(path, at_ns)]
        edge = {"line": {"color": palette.MISSED, "width": 2.2}}
        title = f"missed revisits ({len(at_ns)})"
        traces["missed"] = [draw_points(positions_at(path, at_ns), title, texts, "white", "diamond", 10, marker=edge)]
    return traces


def _draw_label(
    closures: pd.DataFrame,
    path: PoseSeries,
    name: str,
    color: str,
    symbol: str,
    width: float,
    *,
    always: bool = False,
) -> list[Trace]:
    """A dot at the later keyframe of each closure, and a stroke from it to the earlier one; without any an entry of
    the key, if ``always``.
    """
    if closures.empty and not always:
        return []
    ends = closure_ends(path, closures)
    moments = _describe_moments(path, closures["stamp_ns"].to_numpy())
    texts = [
        f"<b>{name} closure</b><br>keyframe {query} → {reference}<br>{moment}<br>score {score:.4g}"
        + ("" if name == "undecided" else f"<br>off by {error_m:.3f} m, {np.rad2deg(rotation_rad):.2f}°")
        for query, reference, score, error_m, rotation_rad, moment in zip(
            *(closures[column] for column in ("query", "reference", "score", "error_m", "rotation_rad")),
            moments,
            strict=True,
        )
    ]
    title = f"{name} closures ({len(closures)})"
    strokes: FloatArray = np.concatenate([ends, np.full((len(closures), 1, 3), np.nan)], axis=1).reshape(-1, 3)
    return [
        draw_line(strokes[:, 0], strokes[:, 1], title, color, width, legendgroup=name, showlegend=False),
        draw_points(ends[:, 0], title, texts, color, symbol, 6.0 + 2.0 * width, legendgroup=name),
    ]


def _describe_moments(path: PoseSeries, at_ns: Any) -> list[str]:
    """Time and travel (M,) of a path at the times ``at_ns`` (M,)."""
    if not len(path):
        return [""] * len(at_ns)
    seconds = (at_ns - path.stamps_ns[0]) * 1e-9
    return [f"{s:.1f} s, {m:.0f} m travelled" for s, m in zip(seconds, path.travelled_at_m(at_ns), strict=True)]
