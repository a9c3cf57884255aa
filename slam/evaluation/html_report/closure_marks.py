"""Closed loops and missed revisits on the map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slam.evaluation.html_report.chart import Trace
from slam.evaluation.html_report.map_marks import describe_moments, draw_line, draw_points
from slam.evaluation.html_report.markup import format_number
from slam.evaluation.place_recognition.closures import ClosureQuality, RevisitQuality
from slam.evaluation.report.map_frame import MapPaths


@dataclass(frozen=True, slots=True, eq=False)
class _Label:
    """Accepted closures (C,) of one label, and how they look."""

    name: str
    chosen: NDArray[np.bool_]
    symbol: str
    size: float
    width: float


def draw_closures(paths: MapPaths, quality: ClosureQuality) -> list[Trace]:
    """True closures below, then missed revisits, the false closures above all; the legend names empty kinds too."""
    judged = quality.judged
    accepted = judged.accepted
    undecided = _Label("undecided", accepted & ~judged.decided, "circle", 7.0, 1.5)
    if not quality.has_truth:
        return _draw_label(paths, quality, undecided)
    traces = _draw_label(paths, quality, _Label("true", accepted & judged.true, "circle", 7.0, 1.5))
    if undecided.chosen.any():
        traces += _draw_label(paths, quality, undecided)
    if quality.revisits is not None:
        traces.append(_draw_missed(paths, quality.revisits))
    wrong = _Label("false", accepted & judged.decided & ~judged.true, "x", 12.0, 3.0)
    return traces + _draw_label(paths, quality, wrong)


def _draw_missed(paths: MapPaths, revisits: RevisitQuality) -> Trace:
    at_ns = revisits.missed_stamps_ns
    texts = [f"<b>missed revisit</b><br>{moment}" for moment in describe_moments(paths.estimate, at_ns)]
    line = {"color": "--missed", "width": 2.2}
    marker = {"color": "--surface", "symbol": "diamond", "size": 10, "line": line}
    return draw_points(paths.positions_at(at_ns), f"missed revisits ({len(at_ns)})", texts, marker)


def _draw_label(paths: MapPaths, quality: ClosureQuality, label: _Label) -> list[Trace]:
    """A dot at the later keyframe of each closure, and a stroke from it to the earlier one."""
    rows = np.flatnonzero(label.chosen)
    ends = paths.closure_ends(quality.judged)[rows]
    color, name = f"--closure-{label.name}", f"{label.name} closures ({len(rows)})"
    moments = describe_moments(paths.estimate, quality.judged.query_stamps_ns[rows])
    texts = [_describe(quality, label.name, row, moment) for row, moment in zip(rows.tolist(), moments, strict=True)]
    marker = {"color": color, "symbol": label.symbol, "size": label.size}
    points = draw_points(ends[:, 0], name, texts, marker) | {"legendgroup": label.name}
    if len(rows) == 0:
        return [points]
    # A third, undefined point lifts the pen between two strokes.
    strokes = np.concatenate([ends, np.full((len(rows), 1, 3), np.nan)], axis=1).reshape(-1, 3)
    line = draw_line(strokes, name, color, label.width, hoverinfo="skip", showlegend=False)
    # Plotly takes a large mark to be farther from the mouse than a line beneath it; an unseen small one is hit.
    small = {"color": color, "size": 6.0, "opacity": 0.0}
    target = draw_points(ends[:, 0], "target", texts, small) | {"legendgroup": label.name, "showlegend": False}
    return [line | {"legendgroup": label.name}, points | {"hoverinfo": "skip", "hovertemplate": ""}, target]


def _describe(quality: ClosureQuality, label: str, row: int, moment: str) -> str:
    judged = quality.judged
    candidate = judged.candidates[row]
    error = ""
    if judged.decided[row]:
        error = (
            f"<br>off by {format_number(float(np.linalg.norm(judged.errors_xyz[row])), 3)} m, "
            f"{format_number(float(np.rad2deg(judged.rotation_errors_rad[row])), 3)}°"
        )
    return (
        f"<b>{label} closure</b><br>keyframe {candidate.query_keyframe_id} → {candidate.reference_keyframe_id}"
        f"<br>{moment}<br>score {format_number(candidate.score)}{error}"
    )
