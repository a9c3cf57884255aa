"""Tables of the lab: rows of cells by their headings, on a terminal, as Markdown or as JSON."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from slam.sweeps.mapped_drive import MappedDrive

Row = Mapping[str, str]
Columns = Mapping[str, tuple[str, int, float]]
"""Heading -> key of a figure in an evaluation's JSON, digits, and factor."""
Markdown = Annotated[bool, typer.Option("--markdown", help="Print the table in Markdown.")]
UNDEFINED = "–"


def number(value: float | None, digits: int, factor: float = 1.0) -> str:
    """A number with so many digits; a dash where it is undefined."""
    return UNDEFINED if value is None else f"{factor * value:.{digits}f}"


def percent(share: float | None, digits: int = 1) -> str:
    """A share in per cent."""
    return number(share, digits, 100.0)


def figures_of(run: MappedDrive, columns: Columns) -> dict[str, str]:
    """Figures of a mapped drive by their headings."""
    return {heading: number(run.figure(key), digits, factor) for heading, (key, digits, factor) in columns.items()}


def with_progress(runs: Iterable[MappedDrive], total: int) -> Iterator[MappedDrive]:
    """The same runs; a line for each goes to standard error."""
    for done, run in enumerate(runs, start=1):
        how = f"failed: {run.error}" if run.error else f"{run.seconds:.0f} s"
        typer.echo(f"{done} of {total}: {run.name}, {how}", err=True)
        yield run


def report(
    rows: Sequence[Row],
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


def to_markdown(rows: Sequence[Row], *, texts: Collection[str] = ()) -> str:
    """The rows as a table in Markdown; the first column and ``texts`` are to the left."""
    headings = list(rows[0]) if rows else []
    alignment = ["---" if heading in (*headings[:1], *texts) else "---:" for heading in headings]
    return "\n".join(_line(cells) for cells in (headings, alignment, *(list(row.values()) for row in rows)))


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cell.replace('|', chr(92) + '|').replace(chr(10), ' ') for cell in cells)} |"
