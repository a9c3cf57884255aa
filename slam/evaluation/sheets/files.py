"""Tables of several runs as files, of the kind that their names say."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from logs.errors import UnwritableLogError
from logs.storage.placement import put_in_place
from slam.common.errors import EvaluationError
from slam.evaluation.sheets.page import compose_sheets_page
from slam.evaluation.sheets.sheet import Sheet, to_csv, to_latex

ENDINGS = (".csv", ".tex", ".html")


def check_endings(paths: Sequence[Path]) -> None:
    """Refuse a file of another kind.

    Raises:
        EvaluationError: its name ends otherwise than in :data:`ENDINGS`.
    """
    for path in paths:
        if path.suffix.lower() not in ENDINGS:
            raise EvaluationError(f"{path}: a table is written as {', '.join(ENDINGS)}; give such a name")


def write_sheets(path: Path, title: str, sheets: Sequence[Sheet], runs: Mapping[str, Mapping[str, Any]]) -> None:
    """Write tables as CSV, LaTeX, or a page with the precision-recall curves of ``runs`` by name; whole or not at all.

    Raises:
        EvaluationError: the name says no kind.
        UnwritableLogError: the file cannot be written.
    """
    check_endings([path])
    match path.suffix.lower():
        case ".csv":
            text = to_csv(sheets)
        case ".tex":
            text = to_latex(sheets)
        case _:
            text = compose_sheets_page(title, sheets, runs)
    part = path.with_name(path.name + ".part")
    try:
        part.write_text(text, encoding="utf-8", newline="\n")
        put_in_place(part, path)
    except OSError as error:
        raise UnwritableLogError(f"cannot write {path}: {error.strerror or error}") from error
