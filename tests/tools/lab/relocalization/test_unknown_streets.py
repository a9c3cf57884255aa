"""Robots that are put down anywhere in a map that nobody drove."""

from __future__ import annotations

import numpy as np
import pytest

from slam.common.config import Config
from slam.place_recognition.imported_map import ImportedMap, make_imported_map
from tools.lab.relocalization.unknown_streets import BESIDE_M, _street, benchmark_in_map

UNCALIBRATED = Config.model_validate({"calibrate": False})


def rows_of_trees() -> ImportedMap:
    """Ten rows of forty trees along x, irregularly 8 m apart."""
    rng = np.random.default_rng(1)
    x, y = np.meshgrid(8.0 * np.arange(40), 60.0 * np.arange(10))
    plane = np.stack([x.ravel(), y.ravel()], axis=1) + rng.normal(0.0, 1.5, (x.size, 2)) * [1.0, 0.2]
    positions = np.column_stack([plane, np.zeros(len(plane))])
    ids = [str(i) for i in range(len(plane))]
    return make_imported_map(positions, ["tree"] * len(plane), ids, sigma_m=0.3)


def test_the_robot_goes_along_the_row_beside_which_it_is_put() -> None:
    known = rows_of_trees()
    for seed in range(5):
        street = _street(known, 30.0, length_m=100.0, rng=np.random.default_rng(seed))
        start, end = street.tour
        assert np.linalg.norm(end - start) == pytest.approx(100.0)
        assert abs((end - start)[0]) > 95.0
        rows = np.round(start[1] / 60.0) * 60.0
        assert abs(start[1] - rows) == pytest.approx(BESIDE_M, abs=1.5)


@pytest.mark.slow
def test_what_becomes_of_it_is_measured() -> None:
    result = benchmark_in_map(rows_of_trees(), UNCALIBRATED, kidnaps=2, max_travel_m=60.0)
    assert (result["kidnaps"], result["landmarks"]) == (2, 400)
    assert result["false_relocalization_rate"] == 0.0
