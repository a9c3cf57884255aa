"""What a picture of a sweep shows, from made-up cells."""

from __future__ import annotations

import warnings
from pathlib import Path

import pytest
from matplotlib.figure import Figure

from slam.common.config import Config
from slam.sweeps import picture
from slam.sweeps.cells import Cell, CellResult, Drive
from slam.sweeps.degradations import parse_degradations
from slam.sweeps.picture import draw_sweep
from slam.sweeps.sweep import Sweep, SweepRow

DRIVE = Drive(Path("drive.mcap"), "0" * 64, Config(), "1")


def result(ate_m: float | None, precision: float | None) -> CellResult:
    evaluation = {"trajectory": {"ate_m": ate_m}, "closures": {"precision": precision, "recall": 0.5}}
    return CellResult(evaluation, "", {})


def sweep(*specifications: str, results: tuple[CellResult, ...]) -> Sweep:
    return Sweep(
        DRIVE,
        tuple(
            SweepRow(each, tuple((Cell(DRIVE, each, seed), result) for seed, result in enumerate(results)))
            for each in parse_degradations(specifications)
        ),
        0,
        0.0,
    )


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[Figure]:
    figures: list[Figure] = []
    monkeypatch.setattr(picture, "save_figure", lambda figure, _: figures.append(figure))
    return figures


def test_strengths_of_one_option_are_a_line(drawn: list[Figure]) -> None:
    specifications = ("dropout=0.6", "reversed", "dropout=0.3", "max_range=20")
    draw_sweep(Path("sweep.png"), sweep(*specifications, results=(result(1.0, 0.9), result(3.0, 1.0))))
    ate = drawn[0].axes[-1]
    labels = [label.get_text() for label in ate.get_xticklabels()]
    assert labels == ["undegraded", "dropout=0.3", "dropout=0.6", "reversed", "max_range=20"]
    lines = [line for line in ate.lines if line.get_marker() == "D"]
    assert [list(line.get_xdata()) for line in lines] == [[0.0], [1.0, 2.0], [3.0], [4.0]]
    assert list(lines[1].get_ydata()) == [2.0, 2.0]
    assert ate.get_ylim()[1] > 3.0  # every seed is in sight


@pytest.mark.slow
def test_undefined_and_failed_figures_are_named(drawn: list[Figure]) -> None:
    for results, told in (((result(1.0, None),), "undefined"), ((CellResult(None, "broken", {}),), "failed")):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            draw_sweep(Path("sweep.png"), sweep("dropout=0.3", "dropout=0.6", "reversed", results=results))
        precision = drawn[-1].axes[0]
        assert [text.get_text() for text in precision.texts] == [told] * 4
