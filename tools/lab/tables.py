"""Tables of the lab: rows of cells by their headings, on a terminal or as Markdown."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

Row = Mapping[str, str]
UNDEFINED = "–"


def number(value: float | None, digits: int, factor: float = 1.0) -> str:
    """A number with so many digits; a dash where it is undefined."""
    return UNDEFINED if value is None else f"{factor * value:.{digits}f}"


def percent(share: float | None, digits: int = 1) -> str:
    """A share in per cent."""
    return number(share, digits, 100.0)


def show(rows: Sequence[Row], *notes: str, title: str | None = None, texts: Collection[str] = ()) -> None:
    """Print rows with the same headings as a table; the first column and ``texts`` are to the left."""
    from tools import console

    headings = list(rows[0]) if rows else []
    table = console.grid({heading: heading not in (*headings[:1], *texts) for heading in headings}, title=title)
    for row in rows:
        table.add_row(*row.values())
    console.show(table, *notes)


def to_markdown(rows: Sequence[Row], *, texts: Collection[str] = ()) -> str:
    """The rows as a table in Markdown; the first column and ``texts`` are to the left."""
    headings = list(rows[0]) if rows else []
    alignment = ["---" if heading in (*headings[:1], *texts) else "---:" for heading in headings]
    return "\n".join(_line(cells) for cells in (headings, alignment, *(list(row.values()) for row in rows)))


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cell.replace('|', chr(92) + '|').replace(chr(10), ' ') for cell in cells)} |"
