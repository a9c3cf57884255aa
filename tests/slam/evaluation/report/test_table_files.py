"""Tables of several runs as files."""

from __future__ import annotations

import csv
from pathlib import Path

import pandas as pd
import pytest

from slam.common.errors import EvaluationError
from slam.evaluation.page.charts import draw_precision_recall
from slam.evaluation.report.table_files import write_tables

HARMFUL = "a_b & 50 % <script>"
TABLES = {"t": pd.DataFrame({HARMFUL: {"ATE": "1 ± 2", "x, y": '1 "2"'}})}


def results(*, has_curve: bool = True) -> dict[str, object]:
    curve = {"thresholds": [9.0, 4.0], "precision": [1.0, 0.8], "recall": [0.5, 0.9]}
    return {"closures": {"precision": 1.0, "recall": 0.5, "precision_recall_curve": curve} if has_curve else None}


def written(path: Path) -> str:
    write_tables(path, HARMFUL, TABLES, "how to read it", {HARMFUL: results()})
    return path.read_text(encoding="utf-8")


def test_csv_is_read_back(tmp_path: Path) -> None:
    rows = list(csv.reader(written(tmp_path / "t.csv").splitlines()))
    assert rows == [["", HARMFUL], ["ATE", "1 ± 2"], ["x, y", '1 "2"']]


def test_latex_is_escaped(tmp_path: Path) -> None:
    text = written(tmp_path / "t.tex")
    assert r"a\_b \& 50 \% <script>" in text
    assert r"ATE & 1 ± 2 \\" in text
    assert text.count(r"\begin{tabular}") == text.count(r"\end{tabular}") == 1


def test_page_holds_table_and_names_as_text(tmp_path: Path) -> None:
    text = written(tmp_path / "t.html")
    assert "50 % <script>" not in text
    assert "ATE" in text
    assert "how to read it" in text
    assert '"chart-precision-recall"' in text


def test_curves_of_all_runs_are_in_one_chart() -> None:
    chart = draw_precision_recall({"a": results(), "b": results(), "without truth": results(has_curve=False)})
    assert [trace["mode"] for trace in chart["data"]] == ["lines", "markers"] * 2
    assert chart["data"][0]["x"].tolist() == [0.5, 0.9]
    assert (chart["data"][1]["x"], chart["data"][1]["y"]) == ([0.5], [1.0])
    assert chart["data"][0]["line"]["color"] != chart["data"][2]["line"]["color"]
    assert draw_precision_recall({"x": results(has_curve=False)}) is None


def test_other_endings_are_refused(tmp_path: Path) -> None:
    with pytest.raises(EvaluationError, match=r"\.csv, \.tex, \.html"):
        write_tables(tmp_path / "table.xls", "t", {}, "", {})
