import numpy as np
import pytest

from slam.common.errors import SimulationError
from slam.common.geometry import apply
from tools.lab.retrieval.labelled_map import LabelledMap
from tools.lab.retrieval.path_queries import PathQuery, Scenario, draw_path_queries


def forest(count: int, extent_m: float) -> np.ndarray:
    xy = np.random.default_rng(0).uniform(0.0, extent_m, (count, 2))
    return np.column_stack([xy, np.zeros(count)])


def drawn(positions: np.ndarray, count: int, **scenario: float) -> list[PathQuery]:
    trees = LabelledMap(positions, np.zeros(len(positions), np.int64), ("tree",))
    return draw_path_queries(trees, count, Scenario(**scenario), rng=np.random.default_rng(0))


@pytest.mark.parametrize("clutter", [0.0, 0.3])
def test_observed_objects_are_those_of_the_map_but_for_clutter(clutter: float) -> None:
    positions = forest(600, 300.0)
    of_map = []
    for query in drawn(positions, 20, clutter=clutter, noise_m=0.05):
        placed = apply(query.T_map_query_gt, query.submap.positions)
        nearest_m = np.hypot(*(placed[:, None, :2] - positions[None, :, :2]).transpose(2, 0, 1)).min(axis=1)
        of_map.append(np.mean(nearest_m < 0.25))
    assert np.mean(of_map) == pytest.approx(1.0 - clutter, abs=0.05)


def test_robot_drives_until_it_has_seen_as_many_objects_as_the_scenario_has() -> None:
    positions = forest(600, 600.0)
    few, many = (drawn(positions, 5, objects=count) for count in (10, 40))
    assert {len(query.submap) for query in few} == {10}
    assert {len(query.submap) for query in many} == {40}
    assert all(np.hypot(*query.submap.positions[:, :2].T).max() < 100.0 for query in few)


def test_missing_objects_are_not_observed() -> None:
    positions = forest(3000, 500.0)
    counts = [np.mean([len(query.submap) for query in drawn(positions, 20, missing=missing)]) for missing in (0.0, 0.5)]
    assert counts[1] / counts[0] == pytest.approx(0.5, abs=0.1)


def test_map_too_sparse_for_queries_is_refused() -> None:
    with pytest.raises(SimulationError, match="denser"):
        drawn(forest(50, 5000.0), 2)
