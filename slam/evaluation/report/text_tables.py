"""Tables and numbers as people read them."""

from __future__ import annotations

from collections.abc import Mapping

from rich.cells import cell_len
from rich.table import Table

from slam.evaluation.metrics.trajectory import ErrorStatistics

UNDEFINED = "–"


def counts(numbers: Mapping[str, int]) -> str:
    """Numbers by name in one line."""
    return ", ".join(f"{name} {count}" for name, count in numbers.items()) or "none"


def pairs_table(title: str, rows: dict[str, str]) -> Table:
    """A table of names and values."""
    table = plain_table(title, show_header=False)
    table.add_column(style="cyan")
    table.add_column(min_width=max((cell_len(word) for value in rows.values() for word in value.split()), default=1))
    for name, value in rows.items():
        table.add_row(name, value)
    return table


def keep_cells_whole(table: Table) -> None:
    """A number that loses digits is another number: no column is narrower than its cells, only headings are folded."""
    for column in table.columns:
        column.overflow = "fold"
        column.min_width = max((cell_len(str(cell)) for cell in column.cells), default=1)


def plain_table(title: str, *, show_header: bool = True) -> Table:
    """Without lines, so that it fits 80 columns and can be pasted anywhere."""
    return Table(
        title=f"\n{title}",
        title_justify="left",
        title_style="bold",
        header_style="cyan",
        box=None,
        pad_edge=False,
        padding=(0, 2, 0, 0),
        show_header=show_header,
    )


def error(statistics: ErrorStatistics | None) -> str:
    """The main figures of errors in metres."""
    if statistics is None:
        return UNDEFINED
    return f"median {statistics.median_m:.3f} m, 95 % {statistics.p95_m:.3f} m, max {statistics.max_m:.3f} m"


def fraction(value: float | None, part: int | None, whole: int | None) -> str:
    """A share in percent with what it was counted from."""
    return UNDEFINED if value is None else f"{100.0 * value:.2f} % ({part} of {whole})"


def number(value: float | None) -> str:
    """Three decimals."""
    return UNDEFINED if value is None else f"{value:.3f}"


def count(value: int | None) -> str:
    """A whole number."""
    return UNDEFINED if value is None else str(value)
