"""Output to the terminal: results to standard output, progress to standard error."""

import json
import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from io import StringIO
from typing import Any

from rich.cells import cell_len
from rich.console import Console, RenderableType
from rich.table import Table
from rich.text import Text

from logs.container.json_text import plain
from logs.container.names import visible

PIPE_WIDTH = 120
MAX_LISTED = 40
"""Entries of a list; of a longer one the others are counted."""


_STYLE: dict[str, Any] = {"title_justify": "left", "title_style": "bold", "box": None, "pad_edge": False}


def _as_it_is(text: str) -> Text:
    """Text without markup and control characters."""
    return Text(visible(text))


def show(*parts: RenderableType) -> None:
    """Print texts and tables to standard output; in a pipe as plain lines of a fixed width."""
    piped = StringIO()
    if sys.stdout.isatty():
        out = Console(highlight=False)
    else:
        out = Console(file=piped, width=PIPE_WIDTH, highlight=False, color_system=None)
    for part in parts:
        # What a narrow terminal cannot hold it wraps; cropping would lose numbers.
        out.print(_as_it_is(part) if isinstance(part, str) else part, crop=False)
    sys.stdout.write("".join(f"{line.rstrip()}\n" for line in piped.getvalue().splitlines()))


def show_json(value: Mapping[str, Any]) -> None:
    """Print exactly one JSON object, dataclasses and arrays included; numbers that JSON cannot hold are null."""
    sys.stdout.write(json.dumps(plain(value), indent=2, allow_nan=False) + "\n")


def report(figures: Mapping[str, Any], *, as_json: bool) -> None:
    """Print figures as one JSON object, or their names and values below one another, without those that are empty."""
    if as_json:
        show_json(figures)
    else:
        show(pairs(texts(figures)))


def texts(figures: Mapping[str, Any]) -> dict[str, str]:
    """Figures for people, by their names; those that are empty or undefined are left out."""
    shown = {name.replace("_", " "): _text(value) for name, value in figures.items()}
    return {name: text for name, text in shown.items() if text}


def rows(records: Iterable[Mapping[str, Any]], names: Sequence[str]) -> list[dict[str, str]]:
    """Some figures of each record, for :func:`table`."""
    return [{name.replace("_", " "): _text(record.get(name)) for name in names} for record in records]


def _text(value: Any) -> str:
    if isinstance(value, Mapping):
        return ", ".join(first(f"{name} {_text(each)}" for name, each in value.items()))
    if isinstance(value, list | tuple):
        return "; ".join(first(map(_text, value)))
    return f"{value:.7g}" if isinstance(value, float) else "" if value is None else str(value)


def first(listed: Iterable[str], what: str = "") -> list[str]:
    """The first of a list, and how many more there are."""
    every = list(listed)
    more = [f"and {len(every) - MAX_LISTED} more{what}"] if len(every) > MAX_LISTED else []
    return every[:MAX_LISTED] + more


def pairs(rows: Mapping[str, str]) -> Table:
    """Names and values below one another, without lines."""
    table = Table(show_header=False, **_STYLE)
    table.add_column(overflow="fold", style="cyan")
    table.add_column(overflow="fold")
    for name, value in rows.items():
        table.add_row(_as_it_is(name), _as_it_is(value))
    return table


def table(rows: Sequence[Mapping[Any, str]], *, texts: Collection[str] = (), title: str | None = None) -> Table:
    """Rows with the same headings as a table without lines; the first column and ``texts`` are to the left."""
    shown = Table(title=title, header_style="cyan", **_STYLE)
    for heading in rows[0] if rows else ():
        is_number = bool(shown.columns) and heading not in texts
        width = max(cell_len(row[heading]) for row in rows) if is_number else None  # a number keeps its digits
        shown.add_column(visible(heading), justify="right" if is_number else "left", overflow="fold", min_width=width)
    for row in rows:
        shown.add_row(*map(_as_it_is, row.values()))
    return shown


@contextmanager
def progress_bar(doing: str, finishing: str = "") -> Iterator[Callable[[float], None]]:
    """A callback for the fraction done that moves a bar on a terminal."""
    if not sys.stderr.isatty():
        yield lambda fraction: None
        return
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task(doing, total=1.0)
        yield lambda fraction: progress.update(
            task, completed=fraction, description=f"{doing}: {finishing}" if finishing and fraction >= 1.0 else doing
        )
