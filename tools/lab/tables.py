"""Tables of the lab: rows of cells by their headings, on a terminal, as Markdown or as JSON."""

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    import pandas as pd

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
COMPARED = {
    "ATE m": ("trajectory.ate_m", 3),
    "closures precision": ("closures.precision", 3),
    "closures recall": ("closures.recall", 3),
    "relocalizations right": ("relocalization.success_rate", 3),
    "associations precision": ("associations.precision", 4),
}
"""Figures of a comparison that fit beside one another, with their digits."""


def compared_descriptors(named: Sequence[str] | None) -> list[str]:
    """The descriptors that were named, by default all, and random vectors.

    Raises:
        DescriptorError: one that cannot be made; it is refused before anything is measured.
    """
    from descriptors.baselines import RandomVector
    from descriptors.registry import DESCRIPTOR_NAMES, make_index

    names = list(dict.fromkeys([*(named or DESCRIPTOR_NAMES), RandomVector.name]))
    for name in names:
        make_index(name)
    return names


def rows_of(spreads: "pd.DataFrame") -> list[dict[str, str]]:
    """A row for each group of runs, with some of the figures, and the extremes of the ATE."""
    rows = []
    for label in spreads.index.unique(level=0):
        of = spreads.loc[label]
        texts = {heading: _text(of.loc[key], digits) for heading, (key, digits) in COMPARED.items()}
        ate = of.loc["trajectory.ate_m"]
        extremes = f"{ate['least']:.3f} to {ate['greatest']:.3f}" if ate["count"] else UNDEFINED
        runs = {"runs": f"{label} ({ate['run_count']} runs)", "ATE m": "", "least to greatest": extremes}
        rows.append(runs | texts)
    return rows


def _text(spread: "pd.Series", digits: int) -> str:
    """ "1.27 ± 0.03 * worse"; with the number of runs in which it is defined, where that is not all."""
    if not spread["count"]:
        return UNDEFINED
    deviation = f" ± {spread['standard_deviation']:.{digits}f}" if spread["count"] > 1 else ""
    part = f" ({spread['count']} of {spread['run_count']})" if spread["count"] < spread["run_count"] else ""
    return f"{spread['mean']:.{digits}f}{deviation}{part} {spread['mark']}".strip()


def report(
    figures: Sequence[Mapping[Any, Any]],
    *notes: str,
    columns: Mapping[str, str] | None = None,
    title: str | None = None,
    texts: Collection[str] = (),
    markdown: bool = False,
    json: Mapping[str, Any] | None = None,
) -> None:
    """Print a row of each of the ``figures``, or ``json`` instead; the first column and ``texts`` are to the left.

    ``columns``: heading -> template of :meth:`str.format_map`, shares as "{share:.1%}"; of a template with parts
    between "|" those are left out that name an undefined figure. Without columns the figures are rows themselves.
    """
    from slam.evaluation.report.figures import fill
    from tools import console

    rows = figures
    if columns is not None:
        cells = {heading: template.split("|") for heading, template in columns.items()}
        rows = [
            {heading: fill(each, *parts).replace(" %", "") or UNDEFINED for heading, parts in cells.items()}
            for each in figures
        ]
    if json is not None:
        console.show_json(json)
    elif markdown:
        typer.echo("\n\n".join([*filter(None, [title]), to_markdown(rows, texts=texts), *notes]))
    else:
        console.show(console.table(rows, texts=texts, title=title), *notes)


def to_markdown(rows: Sequence[Mapping[Any, str]], *, texts: Collection[str]) -> str:
    """The rows as a table in Markdown; the first column and ``texts`` are to the left."""
    headings = list(rows[0]) if rows else []
    alignment = ["---" if heading in (*headings[:1], *texts) else "---:" for heading in headings]
    lines = [headings, alignment, *(list(row.values()) for row in rows)]
    plain = [[cell.replace("|", "\\|").replace("\n", " ") for cell in cells] for cells in lines]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in plain)
