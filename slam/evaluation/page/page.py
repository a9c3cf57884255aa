"""The page of an evaluation: a template filled with its lines, pictures and figures."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from logs.container.names import visible
from slam.common.config_tree import CHANGED_SETTINGS
from slam.common.errors import EvaluationError
from slam.common.geometry import travelled_m
from slam.display.map_layers import ESTIMATE, ODOMETRY, TRUTH
from slam.display.map_picture import compose_map, to_png
from slam.evaluation.inputs.records import EvaluationRecords
from slam.evaluation.inputs.synchronization import synchronize
from slam.evaluation.metrics.trajectory import position_errors_m
from slam.evaluation.report.figures import list_figures, summarize
from slam.evaluation.report.picture import compose_picture
from slam.evaluation.result import Evaluation


def compose_page(records: EvaluationRecords, evaluation: Evaluation, *, title: str) -> str:
    """The page of an evaluation as text; the same input gives the same text.

    Args:
        records: what was read.
        evaluation: what was measured of it.
        title: heading of the page; plain text.
    """
    results = evaluation.to_json_dict()
    drawings: dict[str, Callable[[], Figure]] = {
        "Map": lambda: compose_map(compose_picture(records, evaluation, title=title)),
        "Error along the path": lambda: draw_error_along_path(records, evaluation),
        "Precision and recall": lambda: draw_precision_recall(results),
    }
    pictures = {}
    for heading, draw in drawings.items():
        with suppress(EvaluationError):
            pictures[heading] = b64encode(to_png(draw())).decode()
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    environment.finalize = lambda value: visible(value) if type(value) is str else value
    return environment.get_template("page.html").render(
        title=title,
        lines=_describe_run(records) | summarize(results),
        pictures=pictures,
        figures=list_figures(results),
        missing=evaluation.unavailable,
        rules=evaluation.protocol.describe(),
    )


def _describe_run(records: EvaluationRecords) -> dict[str, str]:
    """Version, input, settings and final status of the run."""
    made, status = records.provenance, records.status
    return {
        "version": f"dslam {made.get('version', 'unknown')}",
        "input": f"sha256 {made.get('input_sha256', 'unknown')}",
        "settings": made.get(CHANGED_SETTINGS, "unknown") or "defaults",
        "status": f"{status.level}: {status.message}" if status else "unknown",
    }


def draw_error_along_path(records: EvaluationRecords, evaluation: Evaluation) -> Figure:
    """Distance of each trajectory from the truth over the true path, each trajectory aligned as a whole.

    Raises:
        EvaluationError: no trajectory could be measured.
    """
    figure, axes = _make_chart("true path travelled [m]", "position error [m]")
    for path, errors, name, color in (
        (records.odometry_path, evaluation.odometry, "odometry", ODOMETRY),
        (records.online_path, evaluation.online, "online estimate", TRUTH),
        (records.final_path, evaluation.estimate, "estimate", ESTIMATE),
    ):
        if errors is not None:
            poses = synchronize(path, records.true_path, max_gap_s=evaluation.protocol.max_truth_gap_s)
            errors_m = position_errors_m(poses, errors.alignment)
            axes.plot(travelled_m(poses.T_world_body_gt), errors_m, color=color, label=name)
    if not axes.lines:
        raise EvaluationError("no trajectory has ground truth")
    axes.legend(frameon=False)
    return figure


def draw_precision_recall(results: Mapping[str, Any]) -> Figure:
    """Precision over recall of every threshold on the score of the best candidate; the mark is the result of the run.

    Args:
        results: the evaluation as JSON.

    Raises:
        EvaluationError: there is no curve.
    """
    closures = results["closures"]
    curve = closures.get("precision_recall_curve", {})
    if not curve.get("recall"):
        raise EvaluationError("no revisit, or no candidate")
    figure, axes = _make_chart("recall of revisits", "precision")
    axes.set(xlim=(0.0, 1.03), ylim=(0.0, 1.05))
    axes.plot(curve["recall"], curve["precision"], color=ESTIMATE)
    if closures["precision"] is not None:
        axes.plot(closures["recall"], closures["precision"], "o", color=ESTIMATE, markersize=10)
    return figure


def _make_chart(x: str, y: str) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(16.0, 5.0), dpi=100.0, layout="constrained")
    axes = figure.add_subplot(xlabel=x, ylabel=y)
    axes.grid(visible=True, color="#e5e7eb")
    axes.spines[:].set_visible(False)
    return figure, axes
