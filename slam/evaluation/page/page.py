"""The page of an evaluation: a template filled with its lines, pictures and figures."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from matplotlib.figure import Figure

from logs.container.names import visible
from logs.storage.placement import write_text
from slam.common.config_tree import CHANGED_SETTINGS
from slam.common.errors import EvaluationError
from slam.display.map_picture import compose_map, to_png
from slam.evaluation.inputs.records import EvaluationRecords
from slam.evaluation.page.charts import draw_error_along_path, draw_precision_recall
from slam.evaluation.report.figures import list_figures, summarize
from slam.evaluation.report.picture import compose_picture
from slam.evaluation.result import Evaluation


def write_page(path: Path, records: EvaluationRecords, evaluation: Evaluation, *, title: str) -> None:
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
    """The whole page as text; as :func:`write_page`."""
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
