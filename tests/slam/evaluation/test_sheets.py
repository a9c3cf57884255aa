"""Tables of several runs as files."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path

import pytest

from slam.common.errors import EvaluationError
from slam.evaluation.comparison import Run, compare_runs
from slam.evaluation.sheets.files import write_sheets
from slam.evaluation.sheets.page import draw_precision_recall
from slam.evaluation.sheets.sheet import Sheet, compare_sheet, to_csv, to_latex
from tests.slam.evaluation.browser import needs_chromium, open_browser

HARMFUL = "a_b & 50 % <script>"


def results(ate_m: float, *, curve: bool = True) -> dict[str, object]:
    closures = {
        "precision": 1.0,
        "recall": 0.5,
        "precision_recall_curve": {"thresholds": [9.0, 4.0], "precision": [1.0, 0.8], "recall": [0.5, 0.9]},
    }
    return {"trajectory": {"ate_m": ate_m}, "closures": closures if curve else None}


def two_groups() -> list[Run]:
    return [
        Run(f"{name}{k}", results(ate_m + 0.001 * k), configuration=json.dumps({"keyframe": {"distance_m": m}}))
        for name, ate_m, m in (("a", 1.0, 2.0), (HARMFUL, 3.0, 5.0))
        for k in range(3)
    ]


def test_groups_are_columns_and_marked_where_they_differ() -> None:
    sheet = compare_sheet(compare_runs(two_groups()))
    assert len(sheet.headings) == 3
    assert all("(3 runs)" in heading for heading in sheet.headings[1:])
    rows = {row[0]: row[1:] for row in sheet.rows}
    assert rows["ATE m"][1].endswith(" *")
    assert not rows["ATE m"][0].endswith(" *")
    assert len({len(row) for row in sheet.rows} | {len(sheet.headings)}) == 1


def test_runs_of_one_group_are_columns_beside_their_mean() -> None:
    sheet = compare_sheet(compare_runs(two_groups()[:3]))
    assert sheet.headings == ("", "a0", "a1", "a2", "mean ± deviation")
    assert {row[0]: row[1:] for row in sheet.rows}["ATE m"][:3] == ("1.000", "1.001", "1.002")


def test_csv_is_read_back() -> None:
    sheet = Sheet("t", ("", HARMFUL), (("x, y", '1 "2"'),))
    assert list(csv.reader(to_csv([sheet]).splitlines())) == [["", HARMFUL], ["x, y", '1 "2"']]


def test_latex_escapes_what_it_would_interpret() -> None:
    text = to_latex([Sheet("t", ("", HARMFUL), (("ATE", "1 ± 2"),))])
    assert r"a\_b \& 50 \% <script>" in text
    assert r"ATE & 1 $\pm$ 2 \\" in text
    assert text.count(r"\begin{tabular}{lr}") == text.count(r"\end{tabular}") == 1


def test_all_curves_are_in_one_chart() -> None:
    runs = {run.name: run.results for run in two_groups()}
    chart = draw_precision_recall(runs | {"without truth": results(1.0, curve=False)})
    assert chart is not None
    assert [trace["mode"] for trace in chart.traces] == ["lines", "markers"] * 6
    assert chart.traces[0]["x"] == [0.5, 0.9]
    assert (chart.traces[1]["x"], chart.traces[1]["y"]) == ([0.5], [1.0])
    assert len({(trace["line"]["color"], trace["line"]["dash"]) for trace in chart.traces[::2]}) == 6
    assert draw_precision_recall({"x": results(1.0, curve=False)}) is None


def test_a_file_of_another_kind_is_refused(tmp_path: Path) -> None:
    with pytest.raises(EvaluationError, match=r"\.csv, \.tex, \.html"):
        write_sheets(tmp_path / "table.xls", "t", [], {})


def write_page(folder: Path, runs: list[Run]) -> Path:
    page = folder / "compared.html"
    write_sheets(page, HARMFUL, [compare_sheet(compare_runs(runs))], {run.name: run.results for run in runs})
    return page


def test_the_page_holds_table_and_names_as_text(tmp_path: Path) -> None:
    text = write_page(tmp_path, two_groups()).read_text(encoding="utf-8")
    assert "<script>0" not in text
    assert len(re.findall(r"<button", text)) == 6
    assert "ATE m" in text


@needs_chromium
@pytest.mark.slow
@pytest.mark.parametrize("has_curves", [True, False])
def test_the_page_is_drawn_whole(tmp_path: Path, has_curves: bool) -> None:
    runs = [Run(each.name, each.results if has_curves else results(1.0, curve=False)) for each in two_groups()]
    page = write_page(tmp_path, runs)
    with open_browser(tmp_path / "profile") as browser:
        for width_px in (390, 1280):
            browser.open(page, width_px=width_px)
            assert browser.console() == []
            assert browser.run("return document.documentElement.scrollWidth") == width_px
        assert browser.run("return document.querySelectorAll('.scatterlayer .trace').length") == 12 * has_curves
