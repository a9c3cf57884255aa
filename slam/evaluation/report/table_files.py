"""Tables of several runs as files, of the kind that their names say."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from logs.storage.placement import write_text
from slam.common.errors import EvaluationError

ENDINGS = (".csv", ".tex", ".html")


def check_endings(paths: Sequence[Path]) -> None:
    """Refuse a file of another kind.

    Raises:
        EvaluationError: its name ends otherwise than in :data:`ENDINGS`.
    """
    for path in paths:
        if path.suffix.lower() not in ENDINGS:
            raise EvaluationError(f"{path}: the name of a table ends in {', '.join(ENDINGS)}")


def write_tables(
    path: Path, title: str, tables: Mapping[str, pd.DataFrame], note: str, runs: Mapping[str, Mapping[str, Any]]
) -> None:
    """Write tables as CSV, LaTeX, or a page with the precision-recall curves of ``runs`` by name; whole or not at all.

    Raises:
        EvaluationError: the name has another ending.
        UnwritableLogError: the file cannot be written.
    """
    check_endings([path])
    match path.suffix.lower():
        case ".csv":
            text = "\n".join(frame.to_csv(lineterminator="\n") for frame in tables.values())
        case ".tex":
            parts = (f"% {name}. {note}\n{frame.to_latex(escape=True)}" for name, frame in tables.items())
            text = "\n".join(parts)
        case _:
            from slam.evaluation.page.page import compose_runs_page

            text = compose_runs_page(title, tables, note, runs)
    write_text(path, text)
