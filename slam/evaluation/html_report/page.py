"""The page: its parts in their order, written as one file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from logs.errors import UnwritableLogError
from logs.storage.placement import put_in_place
from slam.common.calibration import DetectionCalibration
from slam.evaluation.html_report.calibration_charts import draw_calibration
from slam.evaluation.html_report.chart import Chart
from slam.evaluation.html_report.closure_charts import draw_candidates, draw_precision_recall
from slam.evaluation.html_report.embedding import compressed_plotly, embed_json, read_part
from slam.evaluation.html_report.error_charts import draw_error_along_path, measure_errors
from slam.evaluation.html_report.legend import render_legend
from slam.evaluation.html_report.map_charts import draw_object_map, draw_trajectory
from slam.evaluation.html_report.markup import escape, format_number
from slam.evaluation.html_report.tables import name_of, render_tables
from slam.evaluation.html_report.theme import style_properties
from slam.evaluation.html_report.tiles import compose_tiles, describe_run, render_run, render_tiles
from slam.evaluation.inputs.records import EvaluationRecords
from slam.evaluation.place_recognition.closures import ClosureQuality
from slam.evaluation.report.map_frame import MapPaths, bring_into_map
from slam.evaluation.result import Evaluation

NOTHING_LOADED = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:"
"""The browser itself refuses whatever would come from outside."""
_NO_SCRIPT = '<noscript><p class="notice">The charts need JavaScript; the tables below do not.</p></noscript>'


@dataclass(frozen=True, slots=True)
class Panel:
    """A section of the page: a chart with a line on how to read it, or in its place why there is none."""

    heading: str
    explanation: str
    chart: Chart | None
    absent: str
    is_wide: bool = True


def write_report(path: Path, records: EvaluationRecords, evaluation: Evaluation, *, title: str) -> None:
    """Write the page of an evaluation, whole or not at all; the same input gives the same bytes.

    Args:
        path: file to write, by way of ``NAME.part``.
        records: what was read.
        evaluation: what was measured of it.
        title: heading of the page; plain text.

    Raises:
        UnwritableLogError: the file cannot be written.
    """
    part = path.with_name(path.name + ".part")
    try:
        part.write_text(compose_page(records, evaluation, title=title), encoding="utf-8", newline="\n")
        put_in_place(part, path)
    except OSError as error:
        raise UnwritableLogError(f"cannot write {path}: {error.strerror or error}") from error


def compose_page(records: EvaluationRecords, evaluation: Evaluation, *, title: str) -> str:
    """The whole page as text; as :func:`write_report`."""
    panels = _lay_out(_compose_panels(records, evaluation))
    main = f"""{render_tiles(compose_tiles(records, evaluation))}
{_NO_SCRIPT}
<div class="panels">
{"".join(_render_panel(panel) for panel in panels)}</div>
<section aria-labelledby="tables">
<h2 id="tables">All numbers</h2>
<p class="explanation">The keys are those of <code>--json</code> and <code>--require</code>.</p>
<div class="tables">
{render_tables(evaluation.to_json_dict())}</div>
{_render_missing(evaluation)}</section>
<section aria-labelledby="protocol">
<h2 id="protocol">Protocol</h2>
{_render_protocol(evaluation)}</section>"""
    return _compose(title, render_run(describe_run(records, evaluation)), main, panels)


def compose_charts_page(title: str, heading: str, chart: Chart | None, explanation: str, tables: str) -> str:
    """A page with one chart, or in its place ``explanation``, above ``tables`` in HTML."""
    panel = Panel(heading, explanation, chart, explanation)
    section = f'<section aria-label="Tables">\n<div class="tables">\n{tables}</div>\n</section>'
    main = f'{_NO_SCRIPT}\n<div class="panels">\n{_render_panel(panel)}</div>\n{section}'
    return _compose(title, "", main, [panel])


def _compose(title: str, head: str, main: str, panels: Sequence[Panel]) -> str:
    """A page around its parts, with the charts of the panels."""
    charts = [
        {"name": chart.name, "traces": chart.traces, "layout": chart.layout}
        for panel in panels
        if (chart := panel.chart) is not None
    ]
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{NOTHING_LOADED}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<title>{escape(title)} – evaluation</title>
<style>
{style_properties()}{read_part("report.css")}</style>
</head>
<body>
<header>
<h1>{escape(title)}</h1>
{head}</header>
<main>
{main}
</main>
<script type="application/json" id="charts">{embed_json(charts)}</script>
<script type="text/plain" id="plotly">{compressed_plotly()}</script>
<script>
{read_part("report.js")}</script>
</body>
</html>
"""


def _lay_out(panels: list[Panel]) -> list[Panel]:
    """Without a chart in one of the two halves of a row, both are wide: a short line leaves no hole beside a chart."""
    is_hole = any(panel.chart is None for panel in panels if not panel.is_wide)
    return [replace(panel, is_wide=True) for panel in panels] if is_hole else panels


def _compose_panels(records: EvaluationRecords, evaluation: Evaluation) -> list[Panel]:
    paths = bring_into_map(records, evaluation)
    quality, missing = evaluation.closures, evaluation.unavailable
    start_ns = int(paths.estimate.stamps_ns[0]) if len(paths.estimate.stamps_ns) else 0
    without_closures = missing.get("closures", "")
    return [
        Panel(
            "Trajectory",
            _describe_paths(paths) + _describe_missed(quality),
            draw_trajectory(paths, quality, measure_errors(records, evaluation)),
            "There is no trajectory: the log holds neither an estimate nor odometry.",
        ),
        Panel(
            "Object map",
            "The confirmed landmarks of the final map. A click on a class hides it, a double click shows it alone.",
            draw_object_map(records.object_map, paths, _sensor_range_m(records)),
            "There is no map: no object map in the log (/slam/map), or no confirmed landmark in it.",
        ),
        Panel(
            "Precision and recall",
            "What accepting every best candidate from a score on would have given." + _describe_sweep(quality),
            draw_precision_recall(quality),
            _reason(without_closures, "the drive comes back to no earlier place, or nothing was a candidate"),
            is_wide=False,
        ),
        Panel(
            "Error along the path",
            "Distance from the true position, each trajectory aligned as a whole.",
            draw_error_along_path(records, evaluation),
            _reason(missing.get("trajectory", ""), "no trajectory has a truth"),
            is_wide=False,
        ),
        Panel(
            "Candidates over time",
            "Each candidate by its score (0 before it has one), coloured by the stage at which it was decided. Dots "
            "are true by the ground truth, crosses false, rings undecided. A click shows the candidate on the object "
            "map: a line between its keyframes, and over the landmarks about the earlier one those about the later "
            "one, as rings of their colours, where the candidate puts them. If it is true, rings lie about dots.",
            draw_candidates(quality, start_ns, paths),
            _reason(without_closures, "no loop-closure candidate in the log"),
        ),
        Panel(
            "Calibration",
            "Errors by the covariances of the map. Below the dotted line the map is too sure of itself (NEES above 1), "
            "above it too careful.",
            draw_calibration(evaluation.calibration),
            _reason(missing.get("calibration", ""), "no error has a covariance to compare it with"),
        ),
    ]


def _render_panel(panel: Panel) -> str:
    chart = panel.chart
    name = panel.heading.lower().replace(" ", "-")
    kind = "panel wide" if panel.is_wide else "panel"
    if chart is None:
        content = f'<p class="absent">{escape(panel.absent)}</p>'
    else:
        content = (
            f'<p class="explanation">{escape(panel.explanation)}</p>\n'
            f"{render_legend(chart)}"
            f'<div class="chart {chart.shape}" id="chart-{chart.name}" role="img" aria-label="{chart.summary}"></div>'
        )
    heading = f'<h2 id="{name}">{panel.heading}</h2>'
    return f'<section class="{kind}" aria-labelledby="{name}">\n{heading}\n{content}\n</section>\n'


def _render_missing(evaluation: Evaluation) -> str:
    items = "".join(
        f"<li><strong>{escape(name_of(part))}</strong>: {escape(why)}</li>\n"
        for part, why in evaluation.unavailable.items()
    )
    return f"<h3>Not measured</h3>\n<ul>\n{items}</ul>\n" if items else ""


def _render_protocol(evaluation: Evaluation) -> str:
    rules = "".join(
        f"<dt>{escape(name_of(name))}</dt><dd>{escape(rule)}</dd>\n"
        for name, rule in evaluation.protocol.describe().items()
    )
    return (
        "<details>\n<summary>The rules and thresholds by which everything was measured</summary>\n"
        f'<dl class="rules">\n{rules}</dl>\n</details>\n'
    )


def _describe_paths(paths: MapPaths) -> str:
    text = "From above, odometry and estimate from the same start"
    if len(paths.truth):
        text += ", the truth aligned with the estimate. The estimate is coloured by its error"
    if paths.estimate_jumps.size or paths.odometry_jumps.size:
        text += ". Where a line ends and another begins, the robot was carried off or the odometry jumped"
    return f"{text}. Each dot is a keyframe at which a loop was closed, its stroke leads to the earlier keyframe."


def _sensor_range_m(records: EvaluationRecords) -> float:
    """That by which the log was made."""
    return records.sensor_range_m or DetectionCalibration().sensor_range_m


def _describe_missed(quality: ClosureQuality | None) -> str:
    revisits = quality.revisits if quality else None
    if revisits is None or not revisits.missed_by_stage:
        return ""
    stages = ", ".join(f"{stage.replace('_', ' ')} {count}" for stage, count in revisits.missed_by_stage.items())
    return f" Missed revisits by stage: {stages}."


def _describe_sweep(quality: ClosureQuality | None) -> str:
    sweep = quality.revisits.sweep if quality and quality.revisits else None
    if sweep is None:
        return ""
    return (
        f" Average precision {format_number(sweep.average_precision)}, largest F1 {format_number(sweep.f1_max)}, "
        f"recall at full precision {format_number(sweep.recall_at_full_precision)}."
    )


def _reason(missing: str, otherwise: str) -> str:
    text = missing or otherwise
    return f"Not measured: {text}." if not text.endswith(".") else f"Not measured: {text}"
