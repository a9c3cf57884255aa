"""The drive and its map from above."""

from __future__ import annotations

import numpy as np

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
from slam.evaluation.report.picture import closure_ends, estimated_path
from slam.evaluation.result import Evaluation

MAX_LANDMARKS = 5000
"""Of more than these every class is thinned alike: a browser draws each as an object of its own."""
TRUTH = "#6b7280"
"""Grey, which is seen on a white and on a dark page."""


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
    traces += [  # each covers those before it
        *_draw_closures("true", palette.TRUE_CLOSURE, evaluation, path),
        *_draw_closures("undecided", palette.CLOSURE, evaluation, path),
        *_draw_errors(records, evaluation),
        *_draw_closures("false", palette.FALSE_CLOSURE, evaluation, path, width=3.0),
    ]
    missed = picture.missed_revisits
    marks = (
        (missed, f"missed revisits ({len(missed)})", palette.MISSED, "diamond-open", 10),
        (picture.lost, f"lost ({len(picture.lost)})", palette.LOST, "triangle-down", 14),
        (picture.found, f"found ({len(picture.found)})", palette.FOUND, "triangle-up", 14),
        (path.positions[:1], "start", palette.START, "circle", 14),
        (path.positions[-1:], "end", palette.END, "square", 14),
    )
    return make_chart(
        [
            *traces,
            *(
                draw_points(places, name, [f"<b>{name}</b>"] * len(places), color, symbol, size)
                for places, name, color, symbol, size in marks
                if len(places)
            ),
        ],
        **view_from_above(picture.points),
    )


def draw_object_map(picture: MapPicture, records: EvaluationRecords) -> Chart | None:
    """Confirmed landmarks by class over the estimated path; None where there is none."""
    objects = records.object_map
    if objects is None or not len(picture.landmarks):
        return None
    confirmed = [row for row, state in enumerate(objects.states) if state == CONFIRMED]
    path = picture.estimate
    traces = [draw_line(path[:, 0], path[:, 1], "path", "#94a3b8", 1.0, showlegend=False)]
    for group in palette.group_classes(picture.labels):
        share = max(MAX_LANDMARKS * len(group.rows) // len(confirmed), 1)
        rows = group.rows[thin(np.ones(len(group.rows), dtype=np.bool_), share)]
        shown = f"{len(rows)}" if len(rows) == len(group.rows) else f"{len(rows)} of {len(group.rows)}"
        texts = [
            f"<b>{label(picture.labels[row])}</b><br>{label(objects.ids[confirmed[row]])}<br>"
            f"{int(objects.observation_counts[confirmed[row]])} measurements"
            for row in rows.tolist()
        ]
        name = f"{label(group.name)} ({shown})"
        traces.append(draw_points(picture.landmarks[rows], name, texts, group.color, max(group.index, 0)))
    points = np.concatenate([path, picture.landmarks])
    return make_chart(
        traces,
        **view_from_above(points),
    )


def _draw_errors(records: EvaluationRecords, evaluation: Evaluation) -> list[Trace]:
    """A dot at each position of the estimate, coloured by its error, with the time."""
    poses = match_poses(records.final_path, records.true_path, evaluation)
    if evaluation.estimate is None or poses is None:
        return []
    errors_m = position_errors_m(poses, evaluation.estimate)
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


def _draw_closures(
    kind: str, color: str, evaluation: Evaluation, path: PoseSeries, *, width: float = 1.5
) -> list[Trace]:
    """A dot at the later keyframe of each accepted closure that is so, and a stroke to the earlier one."""
    if evaluation.closures is None:
        return []
    every = evaluation.closures[evaluation.closures["accepted"]]
    is_kind = {"true": every["true"], "undecided": ~every["decided"], "false": every["decided"] & ~every["true"]}
    closures = every[is_kind[kind]]
    if closures.empty:
        return []
    ends = closure_ends(path, closures)
    texts = [
        f"<b>{kind} closure</b><br>keyframe {each.query} → {each.reference}<br>score {each.score:.4g}"
        + ("" if kind == "undecided" else f"<br>off by {each.error_m:.3f} m")
        for each in closures.itertuples()
    ]
    title, symbol = f"{kind} closures ({len(closures)})", "x" if kind == "false" else "circle"
    strokes = np.concatenate([ends, np.full((len(closures), 1, 3), np.nan)], axis=1).reshape(-1, 3)
    return [
        draw_line(strokes[:, 0], strokes[:, 1], title, color, width, legendgroup=kind, showlegend=False),
        draw_points(ends[:, 0], title, texts, color, symbol, 6.0 + 2.0 * width, legendgroup=kind),
    ]
