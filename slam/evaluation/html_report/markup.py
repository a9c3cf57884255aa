"""Pieces of HTML from texts that may come from anywhere."""

from __future__ import annotations

import html
import math
import unicodedata
from collections.abc import Sequence
from typing import Any

UNDEFINED = "–"
LONGEST_NAME = 80


def escape(text: str) -> str:
    """``text`` as HTML and plotly.js show it letter by letter, on one line; what cannot be shown is replaced."""
    # Control characters, and halves of surrogate pairs, which UTF-8 cannot write.
    shown = "".join("\N{REPLACEMENT CHARACTER}" if unicodedata.category(c) in ("Cc", "Cs") else c for c in text)
    # plotly.js knows the numbers of characters, but not all of their names.
    return html.escape(shown, quote=True).replace("&quot;", "&#34;")


def escape_name(name: str) -> str:
    """A name or reason from a log as :func:`escape`, cut where it is too long for a label."""
    return escape(name if len(name) <= LONGEST_NAME else name[: LONGEST_NAME - 1] + "…")


def format_value(value: Any) -> str:
    """A number, text or list of a result as a person reads it; undefined is a dash."""
    if value is None:
        return UNDEFINED
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return format_number(value)
    if isinstance(value, list | tuple):
        return ", ".join(format_value(item) for item in value) if value else "none"
    return str(value)


def format_number(value: float | None, digits: int = 4) -> str:
    """``value`` to so many digits that count; whole numbers keep all before the point."""
    if value is None or not math.isfinite(value):
        return UNDEFINED
    if value != 0.0 and not 1e-3 <= abs(value) < 1e6:
        return f"{value:.{digits - 1}g}"
    decimals = digits - 1 - (math.floor(math.log10(abs(value))) if value else 0)
    return f"{value:.{max(decimals, 0)}f}"


def format_metres(value: float, digits: int = 3) -> str:
    """A length with its unit, which stays on its line."""
    return f"{format_number(value, digits)}\N{NO-BREAK SPACE}m"


def format_percent(fraction: float | None) -> str:
    """A fraction in percent, never rounded up to 100 or down to 0."""
    if fraction is None:
        return UNDEFINED
    percent = 100.0 * fraction
    if 0.0 < percent < 100.0:
        percent = min(max(percent, 0.1), 99.9)
    return f"{percent:.{0 if percent in (0.0, 100.0) else 1}f}\N{NO-BREAK SPACE}%"


def table(
    caption: str, header: Sequence[str], rows: Sequence[tuple[str, Sequence[str]]], *, kind: str = "numbers"
) -> str:
    """A table with row headers; all texts are escaped here.

    Args:
        caption: its heading.
        header: of all columns, that of the row headers first.
        rows: row header and cells.
        kind: class of the style.
    """
    head = "".join(f'<th scope="col">{escape(text)}</th>' for text in header)
    body = "".join(
        f'<tr><th scope="row">{escape(name)}</th>' + "".join(f"<td>{escape(cell)}</td>" for cell in cells) + "</tr>\n"
        for name, cells in rows
    )
    return (
        f'<div class="scroll" tabindex="0" role="region" aria-label="{escape(caption)}"><table class="{kind}">'
        f"<caption>{escape(caption)}</caption>\n<thead><tr>{head}</tr></thead>\n<tbody>\n{body}</tbody></table></div>\n"
    )
