"""The drive and its map from above."""

from __future__ import annotations

import numpy as np

from logs.messages import ObjectMapRecord
from slam.evaluation.html_report.chart import Chart, Trace, map_layout, thin_rows
from slam.evaluation.html_report.closure_marks import draw_closures
from slam.evaluation.html_report.map_marks import describe_moments, draw_line, draw_points
from slam.evaluation.html_report.markup import escape_name
from slam.evaluation.inputs.synchronization import PoseSeries
from slam.evaluation.metrics.landmarks import CONFIRMED
from slam.evaluation.place_recognition.closures import ClosureQuality
from slam.evaluation.report.map_frame import MapPaths
from slam.visualization.palette import LEGEND_CLASSES, group_classes

MOST_LANDMARKS = 5000
"""Of more than these every class is thinned alike: a browser draws each as an object of its own."""
SYMBOLS = (
    *("circle", "square", "triangle-up", "diamond", "triangle-down", "cross"),
    *("x", "pentagon", "hexagon", "star", "triangle-left", "triangle-right"),
)


def draw_trajectory(paths: MapPaths, quality: ClosureQuality | None) -> Chart | None:
    """Odometry, estimate and truth with closures and missed revisits; None where there is no path at all."""
    traces = _draw_paths(paths)
    if not traces:
        return None
    counts = ""
    if quality is not None:
        closures = draw_closures(paths, quality)
        traces += closures
        counts = ": " + ", ".join(trace["name"] for trace in closures if trace.get("showlegend", True))
    traces += _draw_ends(paths.estimate)
    points = np.concatenate([paths.estimate.positions, paths.odometry, paths.truth])
    return Chart("trajectory", f"The trajectory from above{counts}", traces, map_layout(points), "map")


def draw_object_map(object_map: ObjectMapRecord | None, paths: MapPaths) -> Chart | None:
    """Confirmed landmarks by class over the estimated path; None where there is none."""
    if object_map is None:
        return None
    rows = [row for row, state in enumerate(object_map.states) if state == CONFIRMED]
    if not rows:
        return None
    names = object_map.labels
    labels = tuple(names[row] for row in rows)
    path = paths.estimate.positions[thin_rows(len(paths.estimate.stamps_ns))]
    traces = [draw_line(path, "path", "--online", 1.0, hoverinfo="skip", showlegend=False)] if len(path) else []
    size = float(np.clip(220.0 / np.sqrt(len(rows)), 6.0, 11.0))
    for index, (name, members) in enumerate(group_classes(labels)):
        is_other = index == LEGEND_CLASSES
        color, symbol = ("--other", "circle") if is_other else (f"--class-{index}", SYMBOLS[index])
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
    return Chart("objects", summary, traces, map_layout(np.concatenate([path, object_map.positions[rows]])), "map")


def _draw_paths(paths: MapPaths) -> list[Trace]:
    estimate = paths.estimate
    traces = []
    if len(paths.odometry):
        thinned = paths.odometry[thin_rows(len(paths.odometry))]
        traces.append(draw_line(thinned, "odometry (before)", "--odometry", 1.5, hoverinfo="name"))
    if len(estimate.stamps_ns):
        rows = thin_rows(len(estimate.stamps_ns))
        moments = describe_moments(estimate, estimate.stamps_ns[rows])
        line = draw_line(estimate.positions[rows], "estimate (after)", "--estimate", 2.5)
        traces.append(line | {"text": moments, "hovertemplate": "%{text}<extra>estimate</extra>"})
    if len(paths.truth):
        thinned = paths.truth[thin_rows(len(paths.truth))]
        traces.append(draw_line(thinned, "ground truth", "--truth", 1.2, dash="dash", hoverinfo="name"))
    return traces


def _draw_ends(path: PoseSeries) -> list[Trace]:
    if len(path.stamps_ns) == 0:
        return []
    traces = []
    for row, name, symbol in ((0, "start", "circle"), (-1, "end", "square")):
        marker = {"color": f"--{name}", "symbol": symbol, "size": 13, "line": {"color": "--surface", "width": 1.5}}
        traces.append(draw_points(path.positions[[row]], name, [name], marker))
    return traces
