"""Tables on pages of results, between marks that name the command."""

from __future__ import annotations

from pathlib import Path

import typer


def with_block(page: Path, command: str, block: str) -> str:
    """The text of a page with the block between the marks of a command; a new page where there is none.

    Raises:
        typer.BadParameter: a page without these marks.
    """
    begin, end = f"<!-- begin of {command} -->\n", f"<!-- end of {command} -->\n"
    text = page.read_text(encoding="utf-8") if page.exists() else f"# {command}\n\n{begin}{end}"
    before, found_begin, rest = text.partition(begin)
    _, found_end, after = rest.partition(end)
    if not found_begin or not found_end:
        raise typer.BadParameter(f"{page} has no lines {begin.strip()} and {end.strip()}.", param_hint="--page")
    return f"{before}{begin}{block}\n{end}{after}"
