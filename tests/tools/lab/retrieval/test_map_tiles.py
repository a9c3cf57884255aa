from __future__ import annotations

import numpy as np
import pytest

from logs.importers.maps.map_objects import MapObjects
from slam.common.config import Config
from slam.common.errors import SimulationError
from slam.common.geometry import apply
from slam.place_recognition.imported_map import make_imported_map
from tools.lab.retrieval.map_tiles import EXHAUSTIVE, TILES, benchmark_tiles, draw_path_queries, locate


def forest(count: int, extent_m: float, seed: int = 0) -> np.ndarray:
    xy = np.random.default_rng(seed).uniform(0.0, extent_m, (count, 2))
    return np.column_stack([xy, np.zeros(count)])


def objects(positions: np.ndarray, *, is_geodetic: bool = False) -> MapObjects:
    names = tuple(str(row) for row in range(len(positions)))
    return MapObjects("forest", positions, ("tree",) * len(positions), names, is_geodetic, "")


def test_queries_see_what_stands_there() -> None:
    positions = forest(600, 300.0)
    for query in draw_path_queries(positions, ["tree"] * 600, 5, rng=np.random.default_rng(0)):
        placed = apply(query.T_map_query_gt, query.submap.positions)
        nearest_m = np.hypot(*(placed[:, None, :2] - positions[None, :, :2]).transpose(2, 0, 1)).min(axis=1)
        assert np.mean(nearest_m < 0.8) > 0.75


def test_a_query_is_found_in_tiles() -> None:
    positions = forest(2000, 600.0)
    tiles = make_imported_map(positions, ["tree"] * 2000, [str(i) for i in range(2000)], sigma_m=0.3)
    queries = draw_path_queries(positions, ["tree"] * 2000, 8, rng=np.random.default_rng(1))
    answers = [locate(tiles, query.submap, Config()) for query in queries]
    right = [
        T is not None and np.linalg.norm((T - query.T_map_query_gt)[:2, 3]) < 2.0
        for (T, _), query in zip(answers, queries, strict=True)
    ]
    assert sum(right) >= 7
    assert all(is_right for is_right, (_, accepted) in zip(right, answers, strict=True) if accepted)


def test_a_query_has_the_classes_of_the_map_that_it_is_asked_in() -> None:
    query = draw_path_queries(forest(600, 300.0), ["tree", "lamp"] * 300, 1, rng=np.random.default_rng(0))[0]
    names = [query.vocabulary[label] for label in query.submap.labels]
    other = ("bench", "lamp", "post", "tree")
    assert [other[label] for label in query.labelled_as(other).labels] == names


def test_a_map_too_sparse_for_queries_and_degrees_are_refused() -> None:
    with pytest.raises(SimulationError, match="denser"):
        draw_path_queries(forest(50, 5000.0), ["tree"] * 50, 2, rng=np.random.default_rng(0))
    with pytest.raises(SimulationError, match="metres"):
        benchmark_tiles(objects(forest(50, 1.0), is_geodetic=True), [10], queries=1)


@pytest.mark.slow
def test_both_methods_are_measured_in_each_map() -> None:
    cells = benchmark_tiles(objects(forest(1500, 500.0)), [800, 5000], queries=4)
    assert [(cell.method, cell.objects) for cell in cells] == [
        (TILES, 800),
        (EXHAUSTIVE, 800),
        (TILES, 1500),
        (EXHAUSTIVE, 1500),
    ]
    assert all(cell.make_s > 0.0 and cell.file_mb > 0.0 and cell.make_mb > 10.0 for cell in cells)
