"""Tables of several runs as files, of the kind that their names say."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from logs.storage.placement import write_text
from slam.common.errors import EvaluationError

ENDINGS = (".csv", ".tex")


def check_endings(paths: Sequence[Path]) -> None:
    """Refuse a file of another kind.

    Raises:
        EvaluationError: its name ends otherwise than in :data:`ENDINGS`.
    """
    for path in paths:
        if path.suffix.lower() not in ENDINGS:
            raise EvaluationError(f"{path}: the name of a table ends in {', '.join(ENDINGS)}")


def write_table(path: Path, table: pd.DataFrame, note: str) -> None:
    """Write a table as CSV or LaTeX, whole or not at all.

    Raises:
        EvaluationError: the name has another ending.
        UnwritableLogError: the file cannot be written.
    """
    check_endings([path])
    is_csv = path.suffix.lower() == ".csv"
    write_text(path, table.to_csv(lineterminator="\n") if is_csv else f"% {note}\n{table.to_latex(escape=True)}")
