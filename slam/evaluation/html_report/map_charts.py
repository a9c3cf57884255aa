"""The drive and its map from above."""

from __future__ import annotations

import numpy as np

from logs.messages import ObjectMapRecord
from slam.common.arrays import FloatArray, IntArray
from slam.evaluation.html_report.chart import Chart, Trace, map_layout, plain_numbers, thin_rows
from slam.evaluation.html_report.closure_marks import draw_closures
from slam.evaluation.html_report.error_charts import PositionErrors
from slam.evaluation.html_report.map_marks import describe_moments, draw_line, draw_points
from slam.evaluation.html_report.markup import escape_name
from slam.evaluation.inputs.synchronization import PoseSeries
from slam.evaluation.metrics.landmarks import CONFIRMED
from slam.evaluation.place_recognition.closures import ClosureQuality
from slam.evaluation.report.map_frame import MapPaths
from slam.visualization.palette import LEGEND_CLASSES, class_hex, group_classes, lift_pen

MOST_LANDMARKS = 5000
"""Of more than these every class is thinned alike: a browser draws each as an object of its own."""
ERROR_SCALE = [[0.0, "#15803d"], [0.35, "#eab308"], [1.0, "#b91c1c"]]
SYMBOLS = (
    *("circle", "square", "triangle-up", "diamond", "triangle-down", "cross"),
    *("x", "pentagon", "hexagon", "star", "triangle-left", "triangle-right"),
)


def draw_trajectory(paths: MapPaths, quality: ClosureQuality | None, errors: PositionErrors | None) -> Chart | None:
    """Odometry, estimate by its error, and truth, with closures, missed revisits, and where the robot was lost.

    None where there is no path at all.
    """
    traces = _draw_paths(paths)
    if errors is not None:
        traces.append(_draw_errors(errors))
    if not traces:
        return None
    counts = ""
    if quality is not None:
        closures = draw_closures(paths, quality)
        traces += closures
        counts = ": " + ", ".join(trace["name"] for trace in closures if trace.get("showlegend", True))
    traces += [*_draw_losses(paths), *_draw_ends(paths.estimate)]
    points = np.concatenate([paths.estimate.positions, paths.odometry, paths.truth])
    return Chart("trajectory", f"The trajectory from above{counts}", traces, map_layout(points), "map")


def draw_object_map(object_map: ObjectMapRecord | None, paths: MapPaths, sensor_range_m: float) -> Chart | None:
    """Confirmed landmarks by class over the estimated path; None where there is none.

    ``sensor_range_m``: how far about a keyframe its submap reaches, where a candidate is shown.
    """
    if object_map is None:
        return None
    rows = [row for row, state in enumerate(object_map.states) if state == CONFIRMED]
    if not rows:
        return None
    names = object_map.labels
    labels = tuple(names[row] for row in rows)
    path = _thinned(paths.estimate.positions, paths.estimate_jumps)
    traces = [draw_line(path, "path", "--online", 1.0, hoverinfo="skip", showlegend=False)] if len(path) else []
    size = float(np.clip(220.0 / np.sqrt(len(rows)), 6.0, 11.0))
    for index, (name, members) in enumerate(group_classes(labels)):
        is_other = index == LEGEND_CLASSES
        color, symbol = ("--other", "circle") if is_other else (class_hex(name), SYMBOLS[index])
        share = max(MOST_LANDMARKS * len(members) // len(rows), 1)
        chosen = [rows[member] for member in members[thin_rows(len(members), share)]]
        count = f"{len(members)}" if len(chosen) == len(members) else f"{len(chosen)} of {len(members)}"
        texts = [
            f"<b>{escape_name(names[row])}</b><br>{escape_name(object_map.ids[row])}<br>"
            f"{int(object_map.observation_counts[row])} measurements"
            for row in chosen
        ]
        marker = {"color": color, "symbol": symbol, "size": size, "line": {"color": "--surface", "width": 0.7}}
        traces.append(draw_points(object_map.positions[chosen], f"{escape_name(name)} ({count})", texts, marker))
    summary = f"{len(rows)} landmarks of {len(set(labels))} classes from above"
    layout = map_layout(np.concatenate([paths.estimate.positions, object_map.positions[rows]]))
    return Chart("objects", summary, traces, layout | {"meta": {"sensor_range_m": sensor_range_m}}, "map")


def _draw_paths(paths: MapPaths) -> list[Trace]:
    estimate = paths.estimate
    traces = []
    if len(paths.odometry):
        thinned = _thinned(paths.odometry, paths.odometry_jumps)
        traces.append(draw_line(thinned, "odometry (before)", "--odometry", 1.5, hoverinfo="skip"))
    if len(estimate.stamps_ns):
        positions = _thinned(estimate.positions, paths.estimate_jumps)
        rows = _thinned_rows(len(estimate.stamps_ns), paths.estimate_jumps)
        moments = describe_moments(estimate, estimate.stamps_ns[rows])
        line = draw_line(positions, "estimate (after)", "--estimate", 2.5)
        traces.append(line | {"text": moments, "hovertemplate": "%{text}<extra>estimate</extra>"})
    if len(paths.truth):
        thinned = _thinned(paths.truth, paths.truth_jumps)
        traces.append(draw_line(thinned, "ground truth", "--truth", 1.2, dash="dash", hoverinfo="skip"))
    return traces


def _thinned_rows(count: int, jumps: IntArray) -> IntArray:
    """Rows to draw of a path; the one before each jump stands twice, where :func:`_thinned` lifts the pen."""
    rows = np.union1d(thin_rows(count), np.concatenate([jumps, jumps + 1]))
    return np.sort(np.concatenate([rows, jumps]))


def _thinned(positions: FloatArray, jumps: IntArray) -> FloatArray:
    rows = np.union1d(thin_rows(len(positions)), np.concatenate([jumps, jumps + 1]))
    return lift_pen(positions[rows], np.searchsorted(rows, jumps))


def _draw_errors(errors: PositionErrors) -> Trace:
    """A dot at each position of the estimate, coloured by its error."""
    rows = thin_rows(len(errors.error_m))
    high = max(float(np.quantile(errors.error_m, 0.99)), 1e-3)
    marker = {
        "color": plain_numbers(errors.error_m[rows], 3),
        "colorscale": ERROR_SCALE,
        "cmin": 0.0,
        "cmax": high,
        "size": 5,
        "colorbar": {
            "title": {"text": "error [m]", "font": {"color": "--muted", "size": 11}},
            "tickfont": {"color": "--muted", "size": 10},
            "x": 1.01,
            "y": 1.0,
            "xanchor": "left",
            "yanchor": "top",
            "len": 0.32,
            "thickness": 10,
            "outlinewidth": 0,
        },
    }
    points = draw_points(errors.positions[rows], "estimate by its error", [], marker)
    # What the mouse points at are the closures.
    return points | {"hovertemplate": "", "hoverinfo": "skip", "showlegend": False}


def _draw_losses(paths: MapPaths) -> list[Trace]:
    traces = []
    for places, name, symbol in ((paths.lost, "lost", "triangle-down"), (paths.found, "found", "triangle-up")):
        if len(places):
            line = {"color": "--surface", "width": 1.5}
            marker = {"color": f"--{name}", "symbol": symbol, "size": 14, "line": line}
            texts = [f"<b>{name}</b> at ({x:.1f}, {y:.1f}) m" for x, y in places[:, :2]]
            traces.append(draw_points(places, f"{name} ({len(places)})", texts, marker))
    return traces


def _draw_ends(path: PoseSeries) -> list[Trace]:
    if len(path.stamps_ns) == 0:
        return []
    traces = []
    for row, name, symbol in ((0, "start", "circle"), (-1, "end", "square")):
        marker = {"color": f"--{name}", "symbol": symbol, "size": 13, "line": {"color": "--surface", "width": 1.5}}
        traces.append(draw_points(path.positions[[row]], name, [name], marker))
    return traces
