"""Tables of the lab: rows of cells by their headings, on a terminal, as Markdown or as JSON."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from slam.evaluation.comparison import Comparison

Markdown = Annotated[bool, typer.Option("--markdown", help="Print the table in Markdown.")]
ResultFolder = Annotated[
    Path, typer.Option("--output", "-o", metavar="DIR", help="Folder of the results; finished ones are reused.")
]
Descriptors = Annotated[
    list[str] | None,
    typer.Option(
        "--descriptor",
        metavar="NAME",
        help="Descriptor: a name, a weights file or module:Class. Repeatable; by default all.",
    ),
]
UNDEFINED = "–"
COMPARED = ("ATE m", "closures precision", "closures recall", "relocalizations right", "associations precision")
"""Figures of a comparison that fit beside one another."""


def row_of(columns: Mapping[str, str], figures: Mapping[str, Any]) -> dict[str, str]:
    """The cells of ``figures``; ``columns``: heading -> template of :meth:`str.format_map`, shares as "{share:.1%}"."""
    return {heading: _filled(template, figures) for heading, template in columns.items()}


def _filled(template: str, figures: Mapping[str, Any]) -> str:
    try:
        text = template.format_map(figures)
        return text.replace("%", "") if "%}" in template else text
    except (KeyError, TypeError):  # a figure that is not there, or that is None
        return UNDEFINED


def rows_of(comparison: Comparison) -> list[dict[str, str]]:
    """A row for each group of runs, with some of the figures, and the extremes of the ATE."""
    from slam.evaluation.comparison import spread_of
    from slam.evaluation.report.figures import HEADLINE_FIGURES

    table = comparison.to_table().T.reindex(columns=list(COMPARED)).astype(object).fillna(UNDEFINED)
    ate = next(figure for figure in HEADLINE_FIGURES if figure.heading == COMPARED[0])
    spreads = [spread_of(ate, runs) for runs in comparison.groups.values()]
    span = f"{{least:.{ate.digits}f}} to {{greatest:.{ate.digits}f}}"
    table.insert(1, "least to greatest", [_filled(span, asdict(each)) for each in spreads])
    return [{"runs": str(name)} | row for name, row in table.to_dict("index").items()]


def report(
    rows: Sequence[Mapping[Any, str]],
    *notes: str,
    title: str | None = None,
    texts: Collection[str] = (),
    markdown: bool = False,
    json: Mapping[str, Any] | None = None,
) -> None:
    """Print rows with the same headings, the first column and ``texts`` to the left; or ``json`` instead."""
    from tools import console

    if json is not None:
        console.show_json(json)
    elif markdown:
        typer.echo("\n\n".join([*filter(None, [title]), to_markdown(rows, texts=texts), *notes]))
    else:
        console.show(console.table(rows, texts=texts, title=title), *notes)


def to_markdown(rows: Sequence[Mapping[Any, str]], *, texts: Collection[str] = ()) -> str:
    """The rows as a table in Markdown; the first column and ``texts`` are to the left."""
    headings = list(rows[0]) if rows else []
    alignment = ["---" if heading in (*headings[:1], *texts) else "---:" for heading in headings]
    lines = [headings, alignment, *(list(row.values()) for row in rows)]
    plain = [[cell.replace("|", "\\|").replace("\n", " ") for cell in cells] for cells in lines]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in plain)
