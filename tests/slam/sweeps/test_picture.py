"""What a picture of a sweep shows, from made-up cells."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from slam.common.config import Config
from slam.sweeps import picture
from slam.sweeps.cells import Cell, CellResult
from slam.sweeps.degradations import parse_degradations
from slam.sweeps.picture import draw_sweep
from slam.sweeps.sweep import Sweep


def result(ate_m: float | None, precision: float | None) -> CellResult:
    evaluation = {"trajectory": {"ate_m": ate_m}, "closures": {"precision": precision, "recall": 0.5}}
    return CellResult(evaluation)


def sweep(*specifications: str, results: tuple[CellResult, ...]) -> Sweep:
    cells = {
        Cell(Path("drive.mcap"), "0" * 64, Config(), "1", each, seed): result
        for each in parse_degradations(specifications)
        for seed, result in enumerate(results)
    }
    return Sweep(cells, 0, 0.0)


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[Figure]:
    figures: list[Figure] = []
    monkeypatch.setattr(picture, "save_figure", lambda figure, _: figures.append(figure))
    return figures


def shown(axis: Axes) -> list[float]:
    return [float(y) for line in axis.lines if line.get_marker() == "D" for y in line.get_ydata()]


def test_means_are_drawn_in_the_order_of_the_degradations(drawn: list[Figure]) -> None:
    specifications = ("dropout=0.6", "reversed", "dropout=0.3")
    draw_sweep(Path("sweep.png"), sweep(*specifications, results=(result(1.0, 0.9), result(3.0, 1.0))))
    precision, _, ate = drawn[0].axes
    assert [label.get_text() for label in ate.get_xticklabels()] == ["undegraded", *specifications]
    assert shown(ate) == [2.0] * 4
    assert shown(precision) == pytest.approx([0.95] * 4)
    assert ate.get_ylim()[1] > 3.0  # mean and standard deviation are in sight


@pytest.mark.parametrize("undefined", [result(1.0, None), CellResult(None, "broken")])
def test_undefined_and_failed_figures_are_not_drawn(drawn: list[Figure], undefined: CellResult) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        draw_sweep(Path("sweep.png"), sweep("dropout=0.3", results=(undefined,)))
    assert np.isnan(shown(drawn[-1].axes[0])).tolist() == [True, True]
