"""Loop-closure candidates: what each threshold would have accepted, and what became of each over time."""

from __future__ import annotations

from typing import Any

import numpy as np

from logs.closures import STAGES
from slam.common.arrays import IntArray
from slam.common.geometry import invert, yaw_rad
from slam.evaluation.html_report import theme
from slam.evaluation.html_report.chart import Chart, Trace, axis, plain_numbers, thin_rows
from slam.evaluation.html_report.markup import escape_name, format_number, format_percent
from slam.evaluation.place_recognition.closure_labels import JudgedClosures
from slam.evaluation.place_recognition.closures import ClosureQuality
from slam.evaluation.place_recognition.precision_recall import ScoreSweep
from slam.evaluation.report.map_frame import MapPaths

MOST_TURNED_DOWN = 1500
"""Of the candidates that were turned down so many are drawn; of a stage with few of them all."""
FEW = 300


def draw_precision_recall(quality: ClosureQuality | None) -> Chart | None:
    """Precision over recall of every threshold on the score, and where the run stood; None without a sweep."""
    revisits = quality.revisits if quality else None
    sweep = revisits.sweep if revisits else None
    if quality is None or revisits is None or sweep is None or len(sweep.thresholds) == 0:
        return None
    traces = [_draw_curve(sweep)]
    if quality.precision is not None and revisits.recall is not None:
        figures = f"precision {format_percent(quality.precision)}, recall {format_percent(revisits.recall)}"
        traces.append(
            {
                "type": "scatter",
                "mode": "markers",
                "name": f"this run: {figures}",
                "x": plain_numbers([revisits.recall], 5),
                "y": plain_numbers([quality.precision], 5),
                "marker": {
                    "color": "--closure-true",
                    "size": 13,
                    "symbol": "circle",
                    "line": {"color": "--ink", "width": 1.5},
                },
                "hovertemplate": f"{figures}<extra>this run</extra>",
                "cliponaxis": False,
            }
        )
    summary = "Precision over recall of every threshold on the score"
    return Chart("precision-recall", summary, traces, precision_recall_layout())


def precision_recall_layout() -> dict[str, Any]:
    """Axes from nothing to a little more than all."""
    return {
        "xaxis": axis("recall of revisits", range=[0.0, 1.03], tickformat=".0%"),
        "yaxis": axis("precision", range=[0.0, 1.05], tickformat=".0%"),
    }


def draw_candidates(quality: ClosureQuality | None, start_ns: int, paths: MapPaths) -> Chart | None:
    """Score of each candidate over time, coloured by the stage of its decision; None where there is no candidate."""
    if quality is None or quality.candidate_count == 0:
        return None
    judged = quality.judged
    stages = np.array([c.stage for c in judged.candidates], dtype=np.str_)
    traces: list[Trace] = []
    known = [stage for stage in STAGES if (stages == stage).any()]
    for stage in known:
        rows = np.flatnonzero(stages == stage)
        traces.append(_draw_stage(quality, rows, stage, theme.STAGES[stage], start_ns, paths))
    others = np.flatnonzero(~np.isin(stages, known))
    if len(others):
        traces.append(_draw_stage(quality, others, "another", "--other", start_ns, paths))
    layout = {"xaxis": axis("time [s]"), "yaxis": axis("score")}
    return Chart("candidates", f"Score over time of {quality.candidate_count} candidates", traces, layout)


def _draw_curve(sweep: ScoreSweep) -> Trace:
    rows = thin_rows(len(sweep.thresholds), 1000)
    return {
        "type": "scatter",
        "mode": "lines+markers" if len(rows) < 3 else "lines",
        "name": "every threshold on the score",
        "x": plain_numbers(sweep.recall[rows], 5),
        "y": plain_numbers(sweep.precision[rows], 5),
        "text": [f"score ≥ {format_number(float(threshold))}" for threshold in sweep.thresholds[rows]],
        "line": {"color": "--estimate", "width": 2.2},
        "hovertemplate": "%{text}<br>precision %{y:.1%}<br>recall %{x:.1%}<extra></extra>",
    }


def _draw_stage(
    quality: ClosureQuality, rows: IntArray, stage: str, color: str, start_ns: int, paths: MapPaths
) -> Trace:
    judged, count = quality.judged, len(rows)
    if stage != "accepted":
        share = MOST_TURNED_DOWN * count // max(quality.candidate_count - quality.accepted_count, 1)
        rows = rows[thin_rows(count, max(share, FEW))]
    shown = f"{count}" if len(rows) == count else f"{len(rows)} of {count}"
    true, decided = judged.true[rows], judged.decided[rows]
    symbols = np.where(true, "circle", np.where(decided, "x-thin-open", "circle-open"))
    return {
        "type": "scatter",
        "mode": "markers",
        "name": f"{stage.replace('_', ' ')} ({shown})",
        "x": plain_numbers((judged.query_stamps_ns[rows] - start_ns) * 1e-9, 1),
        "y": plain_numbers(np.nan_to_num(judged.scores[rows], nan=0.0, posinf=0.0, neginf=0.0), 2),
        "text": [_describe(judged, row) for row in rows.tolist()],
        "hovertemplate": "%{text}<extra></extra>",
        "customdata": _places(judged, rows, paths),
        "marker": {"color": color, "size": 7, "symbol": symbols.tolist(), "line": {"color": color, "width": 1.2}},
    }


def _describe(judged: JudgedClosures, row: int) -> str:
    candidate = judged.candidates[row]
    earlier = "no place" if candidate.reference_keyframe_id < 0 else f"{candidate.reference_keyframe_id}"
    label = "undecided" if not judged.decided[row] else "true" if judged.true[row] else "false"
    text = f"keyframe {candidate.query_keyframe_id} → {earlier}<br>{escape_name(candidate.stage)}, {label} by the truth"
    return f"{text}<br>{escape_name(candidate.reason)}" if candidate.reason else text


def _places(judged: JudgedClosures, rows: IntArray, paths: MapPaths) -> list[list[float] | None]:
    """For each candidate x and y of query and reference, and where it moves landmarks: x, y, yaw; map frame, m, rad.

    None where it has no transform, or the path does not reach its keyframes.
    """
    T_map_query = paths.poses_at(judged.query_stamps_ns[rows])
    T_map_reference = paths.poses_at(judged.reference_stamps_ns[rows])
    places: list[list[float] | None] = []
    for row, query, reference in zip(rows.tolist(), T_map_query, T_map_reference, strict=True):
        T_reference_query = judged.candidates[row].T_reference_query
        if T_reference_query is None or not (np.isfinite(query).all() and np.isfinite(reference).all()):
            places.append(None)
            continue
        moved = reference @ T_reference_query @ invert(query)
        numbers = [*query[:2, 3], *reference[:2, 3], *moved[:2, 3], float(yaw_rad(moved))]
        places.append([round(float(number), 4) for number in numbers])
    return places
