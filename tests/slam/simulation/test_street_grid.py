import numpy as np
import pytest
from scipy.spatial import cKDTree

from slam.simulation.street_grid import generate_street_grid
from slam.simulation.world import World


@pytest.fixture(scope="module", params=range(2))
def town(request: pytest.FixtureRequest) -> World:
    return generate_street_grid(rng=np.random.default_rng(request.param))


def test_same_seed_same_town_other_seed_other_town() -> None:
    first, again, other = (generate_street_grid(rng=np.random.default_rng(seed)).sha256() for seed in (7, 7, 8))
    assert first == again
    assert first != other


def test_tour_has_its_length_and_fine_steps(town: World) -> None:
    assert 1500.0 <= town.tour_length_m <= 2000.0
    steps_m = np.linalg.norm(np.diff(town.tour, axis=0), axis=1)
    assert steps_m.min() > 0.9
    assert steps_m.max() < 1.1
    along = np.diff(town.tour, axis=0) / steps_m[:, None]
    assert np.sum(along[1:] * along[:-1], axis=1).min() > -0.7  # it never turns round on the spot


def test_tour_revisits_in_both_directions(town: World) -> None:
    heading = np.arctan2(*np.diff(town.tour, axis=0).T[::-1])
    same_m, opposite_m = 0, 0
    tree = cKDTree(town.tour[:-1])
    for i, near in enumerate(tree.query_ball_point(town.tour[:-1], 1.0)):
        earlier = [j for j in near if j < i - 50]  # type: ignore[attr-defined]
        turned = np.cos(heading[i] - heading[earlier]) if earlier else np.array([])
        same_m += bool(np.any(turned > 0.99))
        opposite_m += bool(np.any(turned < -0.99))
    assert same_m > 100
    assert opposite_m > 100


def test_furniture_is_as_dense_and_as_mixed_as_in_a_city(town: World) -> None:
    tree = cKDTree(town.positions[:, :2])
    in_view = [len(near) for near in tree.query_ball_point(town.tour, 30.0)]
    assert 10 <= np.median(in_view) <= 30
    assert len(town.vocabulary) >= 10
    shares = {label: town.labels.count(label) / len(town.labels) for label in town.vocabulary}
    assert max(shares, key=lambda label: shares[label]) == "tree"
    assert {"street_lamp", "traffic_sign", "bollard", "bench", "fire_hydrant", "traffic_signals"} <= shares.keys()
    nearest, _ = tree.query(town.positions[:, :2], k=2)
    assert nearest[:, 1].min() >= 0.6
    on_road_m, _ = cKDTree(town.tour).query(town.positions[:, :2])
    assert on_road_m.min() > 2.0
