"""The page: a template filled with the lines, charts and tables of an evaluation."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from plotly.io import to_html
from plotly.offline import get_plotlyjs

from logs.container.names import visible
from logs.storage.placement import write_text
from slam.common.config import Config
from slam.common.config_tree import changes
from slam.evaluation.inputs.records import EvaluationRecords
from slam.evaluation.page.charts import draw_calibration, draw_error_along_path, draw_map, draw_precision_recall
from slam.evaluation.page.traces import Chart
from slam.evaluation.report.figures import summarize
from slam.evaluation.report.picture import compose_picture, estimated_path
from slam.evaluation.report.tables import make_tables
from slam.evaluation.result import Evaluation

_LAYOUT = {
    "paper_bgcolor": "rgba(0,0,0,0)",
    "plot_bgcolor": "rgba(0,0,0,0)",
    "hovermode": "closest",
    "margin": {"l": 60, "r": 20, "t": 20, "b": 50},
    "legend": {"orientation": "h", "y": 1.02, "yanchor": "bottom"},
    "modebar": {"bgcolor": "rgba(0,0,0,0)", "color": "#8a94a3"},
    "hoverlabel": {"align": "left", "namelength": -1},
}
# All buttons that there are, for among the usual ones is one that sends the chart away.
_BUTTONS = ["zoom2d", "pan2d", "zoomIn2d", "zoomOut2d", "resetScale2d", "toImage"]
_CONFIG = {"displaylogo": False, "responsive": True, "modeBarButtons": [_BUTTONS]}
_COUNTED = {"keyframes": "keyframes", "landmarks_confirmed": "landmarks"}
_PANELS = {
    "map": (
        "Map",
        "Odometry and estimate have the same start; the truth is aligned with the estimate. Lines are interrupted "
        "where the robot was kidnapped or the odometry jumped. Strokes join the keyframes of loop closures. A click on "
        "an entry hides it, a double click shows it alone.",
    ),
    "precision-recall": (
        "Precision and recall",
        "For the best candidate of each keyframe and every threshold on its score; the mark is the result of the run.",
    ),
    "error": (
        "Error along the path",
        "Distance from the true position, each trajectory aligned as a whole.",
    ),
    "calibration": (
        "Calibration",
        "Share of the errors within the confidence regions of the map. Below the dotted line the map is overconfident "
        "(NEES above 1), above it underconfident.",
    ),
}
"""Heading of each chart, and how to read it."""


@dataclass(frozen=True, slots=True)
class Panel:
    """A chart as HTML with a line on how to read it; where there is no chart, the reason in ``absent``."""

    name: str
    heading: str
    explanation: str
    html: str
    absent: str = ""


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
    write_text(path, compose_page(records, evaluation, title=title))


def compose_page(records: EvaluationRecords, evaluation: Evaluation, *, title: str) -> str:
    """The whole page as text; as :func:`write_report`."""
    results = evaluation.to_json_dict()
    picture = compose_picture(records, evaluation)
    missing = evaluation.unavailable
    without_closures = missing.get("closures") or "no revisit, or no candidate"
    charts: dict[str, tuple[Chart | None, str]] = {
        "map": (draw_map(picture, records, evaluation), "the log holds neither an estimate nor odometry nor a map"),
        "precision-recall": (draw_precision_recall(results), without_closures),
        "error": (
            draw_error_along_path(records, evaluation),
            missing.get("trajectory", "no trajectory has ground truth"),
        ),
        "calibration": (draw_calibration(evaluation.consistency), missing.get("calibration", "no error to compare")),
    }
    return _render(
        title,
        lines=describe_run(records, evaluation) | summarize(results),
        panels=[_make_panel(name, chart, f"Not measured: {why}.") for name, (chart, why) in charts.items()],
        tables=make_tables(results),
        missing=missing,
        rules=evaluation.protocol.describe(),
    )


def describe_run(records: EvaluationRecords, evaluation: Evaluation) -> dict[str, str]:
    """What ran, its version, the settings that differ from the defaults, and how it ended."""
    results = evaluation.results
    errors = evaluation.estimate or evaluation.online or evaluation.odometry
    path = estimated_path(records)
    length_m = seconds = 0.0
    if errors is not None:
        length_m, seconds = errors.length_m, errors.duration_s
    elif len(path):
        length_m, seconds = float(path.travelled_m[-1]), float(np.ptp(path.stamps_ns)) * 1e-9
    counters, status = results["counters"], records.status
    parts = [f"{length_m:.0f} m in {seconds / 60.0:.1f} min"] if seconds else ["the log holds no trajectory"]
    parts += [f"{counters[key]} {name}" for key, name in _COUNTED.items() if key in counters]
    parts += ["localized in the saved map of an earlier drive"] if records.has_prior_map else []
    parts += [f"input sha256 {records.provenance['input_sha256'][:12]}"] if "input_sha256" in records.provenance else []
    changed = records.provenance.get("changed_settings")
    if changed is None and records.configuration:
        changed = ", ".join(changes(Config(), json.dumps(records.configuration)))
    settings = f"defaults, but {changed}" if changed else "defaults"
    return {
        "run": ", ".join(parts),
        "version": f"dslam {records.provenance.get('version', 'unknown')}",
        "settings": settings if records.configuration else "unknown: the log does not hold them",
        **({"status": f"{status.level}: {status.message}"} if status else {}),
    }


def _make_panel(name: str, chart: Chart | None, absent: str) -> Panel:
    if chart is None:
        return Panel(name, *_PANELS[name], "", absent)
    html = to_html(
        {"data": chart["data"], "layout": _LAYOUT | {"height": 420} | chart["layout"]},
        config=_CONFIG,
        include_plotlyjs=False,
        full_html=False,
        div_id=f"chart-{name}",
        validate=False,
    )
    return Panel(name, *_PANELS[name], html)


def _render(title: str, *, tables: Mapping[str, pd.DataFrame], **parts: Any) -> str:
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    environment.finalize = lambda value: visible(value) if type(value) is str else value
    html = {name: frame.map(visible).to_html(border=0) for name, frame in tables.items()}
    return environment.get_template("page.html").render(title=title, tables=html, plotly=get_plotlyjs(), **parts)
