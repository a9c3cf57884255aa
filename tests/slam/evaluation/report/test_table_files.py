"""Tables of several runs as files."""

from __future__ import annotations

import csv
from pathlib import Path

import pandas as pd
import pytest

from slam.common.errors import EvaluationError
from slam.evaluation.report.table_files import write_table

HARMFUL = "a_b & 50 % <script>"
TABLE = pd.DataFrame({HARMFUL: {"ATE": "1 ± 2", "x, y": '1 "2"'}})


@pytest.mark.parametrize("name", ["t.csv", "T.CSV"])
def test_csv_is_read_back(tmp_path: Path, name: str) -> None:
    write_table(tmp_path / name, TABLE, "how to read it")
    rows = list(csv.reader((tmp_path / name).read_text(encoding="utf-8").splitlines()))
    assert rows == [["", HARMFUL], ["ATE", "1 ± 2"], ["x, y", '1 "2"']]


def test_latex_is_escaped(tmp_path: Path) -> None:
    write_table(tmp_path / "t.tex", TABLE, "how to read it")
    text = (tmp_path / "t.tex").read_text(encoding="utf-8")
    assert text.startswith("% how to read it\n")
    assert r"a\_b \& 50 \% <script>" in text
    assert r"ATE & 1 ± 2 \\" in text
    assert text.count(r"\begin{tabular}") == text.count(r"\end{tabular}") == 1


def test_other_endings_are_refused(tmp_path: Path) -> None:
    with pytest.raises(EvaluationError, match=r"\.csv, \.tex"):
        write_table(tmp_path / "table.xls", TABLE, "")
