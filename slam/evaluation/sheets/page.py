"""Tables and the precision-recall curves of several runs as one page that opens offline."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from slam.evaluation.html_report.chart import Chart, Trace, plain_numbers, thin_rows
from slam.evaluation.html_report.closure_charts import precision_recall_layout
from slam.evaluation.html_report.markup import escape, escape_name, table
from slam.evaluation.html_report.page import compose_charts_page
from slam.evaluation.metrics.statistics import CHIEF_FIGURES
from slam.evaluation.sheets.sheet import Sheet

COLORS = ("#0b5cad", "#d97706", "#15803d", "#b91c1c", "#7c3aed", "#0891b2", "#be185d", "#65a30d", "#475569", "#a16207")
DASHES = ("solid", "dash", "dot", "dashdot")


def compose_sheets_page(title: str, sheets: Sequence[Sheet], runs: Mapping[str, Mapping[str, Any]]) -> str:
    """The page.

    Args:
        title: plain text.
        sheets: its tables.
        runs: the evaluation of each run as JSON, by the run's name.
    """
    chart = draw_precision_recall(runs)
    tables = "".join(
        f"{table(sheet.title, sheet.headings, [(row[0], row[1:]) for row in sheet.rows])}"
        f'<p class="explanation">{escape(sheet.note)}</p>\n'
        for sheet in sheets
    )
    explanation = (
        "What accepting every best candidate from a score on would have given, run by run; the mark is what was "
        "accepted. A click on a run hides it, a double click shows it alone."
    )
    absent = "No run has a curve: a drive comes back to no earlier place, holds no truth, or nothing was a candidate."
    return compose_charts_page(title, "Precision and recall", chart, explanation if chart else absent, tables)


def draw_precision_recall(runs: Mapping[str, Mapping[str, Any]]) -> Chart | None:
    """Precision over recall of every threshold, all runs in one chart; None where none has a curve."""
    traces: list[Trace] = []
    for name, results in runs.items():
        closures = results.get("closures")
        curve = closures.get("precision_recall_curve") if isinstance(closures, Mapping) else None
        if curve:
            traces += _curve(name, results, curve, number=len(traces) // 2)
    if not traces:
        return None
    summary = f"Precision over recall of {len(traces) // 2} runs"
    return Chart("precision-recall", summary, traces, precision_recall_layout())


def _curve(name: str, results: Mapping[str, Any], curve: Mapping[str, Any], *, number: int) -> list[Trace]:
    rows = thin_rows(len(curve["recall"]), 600).tolist()
    color, dash = COLORS[number % len(COLORS)], DASHES[number // len(COLORS) % len(DASHES)]
    shown, group = escape_name(name), f"run {number}"
    line = {
        "type": "scatter",
        "mode": "lines",
        "name": shown,
        "legendgroup": group,
        "x": plain_numbers([curve["recall"][row] for row in rows], 5),
        "y": plain_numbers([curve["precision"][row] for row in rows], 5),
        "line": {"color": color, "width": 2.2, "dash": dash},
        "hovertemplate": f"{shown}<br>precision %{{y:.1%}}<br>recall %{{x:.1%}}<extra></extra>",
    }
    figure = {each.key: each for each in CHIEF_FIGURES}
    at = [figure[key].of(results) for key in ("closures.recall", "closures.precision")]
    here = None not in at
    mark = {
        "type": "scatter",
        "mode": "markers",
        "name": "accepted",
        "legendgroup": group,
        "showlegend": False,
        "x": [at[0] if here else None],
        "y": [at[1] if here else None],
        "marker": {"color": color, "size": 11, "symbol": "circle"},
        "hovertemplate": f"{shown}<br>accepted: precision %{{y:.1%}}, recall %{{x:.1%}}<extra></extra>",
        "cliponaxis": False,
    }
    return [line, mark]
