"""Poses in a map: pairs of objects propose, the likelihood of all objects decides."""

import numpy as np
import pytest

from descriptors.descriptellation_lr.pair_index import PairIndex
from descriptors.registry import shipped_likelihood
from slam.common.arrays import FloatArray, IntArray
from slam.common.geometry import apply, invert
from slam.object_map.submap import Submap
from slam.place_recognition.place_search import SAME_TURN_RAD, PlaceSearch, _query
from tests.helpers.poses import pose_at

SIGMA_M = 0.2


def town(count: int = 3000, *, classes: int = 1) -> tuple[FloatArray, IntArray]:
    rng = np.random.default_rng(0)
    positions = np.column_stack([rng.uniform(0.0, 10.0 * np.sqrt(count), (count, 2)), np.full(count, 3.0)])
    return positions, rng.integers(classes, size=count)


def searched(positions: FloatArray, labels: IntArray, classes: int = 1) -> PlaceSearch:
    pairs = PairIndex(shipped_likelihood())
    pairs.add(positions, labels)
    return PlaceSearch(pairs, positions, labels, classes)


def observed(
    positions: FloatArray, rng: np.random.Generator, *, missing: float = 0.0, clutter: int = 0
) -> tuple[FloatArray, IntArray, FloatArray]:
    """Objects (N, 3) within 30 m of a robot, their rows (N,), -1 of clutter, and the robot's pose (4, 4)."""
    centre = rng.uniform(100.0, 450.0, 2)
    T_map_query = pose_at(*centre, z=2.0, yaw=float(rng.uniform(-np.pi, np.pi)))
    rows = np.flatnonzero(np.hypot(*(positions[:, :2] - centre).T) < 30.0)
    rows = rows[rng.random(len(rows)) >= missing]
    local = apply(invert(T_map_query), positions[rows])
    local[:, :2] += rng.normal(0.0, SIGMA_M, (len(rows), 2))
    of_nothing = np.column_stack([rng.uniform(-30.0, 30.0, (clutter, 2)), np.full(clutter, local[0, 2])])
    return np.concatenate([local, of_nothing]), np.append(rows, np.full(clutter, -1)), T_map_query


def query(positions: FloatArray, labels: IntArray) -> Submap:
    return Submap(positions, np.full(len(labels), SIGMA_M), labels, np.arange(len(labels)))


def is_near(T: FloatArray, T_gt: FloatArray, *, within_m: float = 0.5) -> bool:
    return bool(np.linalg.norm((T - T_gt)[:3, 3]) < within_m) and bool(np.allclose(T[:3, :3], T_gt[:3, :3], atol=0.1))


def test_objects_that_are_not_allowed_make_no_pose() -> None:
    positions, labels = town()
    seen, rows, T_gt = observed(positions, np.random.default_rng(2))
    allowed = np.ones(len(positions), bool)
    allowed[rows] = False
    poses = searched(positions, labels).find_poses(query(seen, labels[rows]), count=5, allowed=allowed)
    assert len(poses)
    assert not any(is_near(each, T_gt) for each in poses)


def test_pose_is_fitted_to_all_objects_in_view() -> None:
    positions, labels = town()
    seen, rows, T_gt = observed(positions, np.random.default_rng(2))
    T = searched(positions, labels).find_poses(query(seen, labels[rows]), count=5)
    assert len(T) == 5
    assert np.linalg.norm((T[0] - T_gt)[:2, 3]) < 3.0 * SIGMA_M / np.sqrt(len(rows))
    assert T[0, 2, 3] == pytest.approx(2.0, abs=1e-6)
    assert not any(is_near(each, T_gt) for each in T[1:])


def test_pairs_are_compared_by_the_noise_between_neighbours() -> None:
    positions, labels = town()
    search = searched(positions, labels)
    found = {SIGMA_M: 0, None: 0}
    for seed in range(10):
        rng = np.random.default_rng(seed)
        seen, rows, T_gt = observed(positions, rng, missing=0.3, clutter=12)
        seen[:, 1] += seen[:, 0] ** 2 / 100.0  # a bend of the odometry
        for local_sigma_m in found:
            asked = Submap(seen, np.full(len(rows), 3.0), np.zeros_like(rows), rows, local_sigma_m=local_sigma_m)
            T = search.find_poses(asked, map_sigma_m=SIGMA_M, count=1)[0]
            found[local_sigma_m] += is_near(T, T_gt, within_m=3.0)
    assert found[SIGMA_M] >= 9
    assert found[None] <= 3


@pytest.mark.parametrize("count", [0, 1])
def test_query_of_too_few_objects_has_no_pose(count: int) -> None:
    positions, labels = town(50)
    found = searched(positions, labels).find_poses(query(np.zeros((count, 3)), labels[:count]), count=5)
    assert found.shape == (0, 4, 4)


@pytest.mark.parametrize("yaw", [0.0, 1.0, np.pi])
def test_of_poses_that_are_one_the_likeliest_is_kept(yaw: float) -> None:
    search = searched(*town(50))
    apart_m, turn_rad = 0.4 * search._spacing_m, 0.8 * SAME_TURN_RAD
    middles = 20.0 + np.array([0.0, apart_m, apart_m * 1j, 2.0 * apart_m, 0.0])
    poses = np.array([middles, np.exp(1j * (yaw + np.array([0.0, turn_rad, -turn_rad, 0.0, 2.0 * turn_rad])))])
    assert search._distinct(poses, np.array([5.0, 4.0, 3.0, 2.0, 1.0]), 5).tolist() == [0, 3, 4]
    assert search._distinct(poses, np.arange(5.0), 2).tolist() == [4, 3]


def test_class_without_objects_meets_nothing() -> None:
    positions, labels = town()
    search = searched(positions, labels, classes=3)
    rng = np.random.default_rng(5)
    seen, rows, _ = observed(positions, rng)
    mixed = np.where(rng.random(len(rows)) < 0.5, 2, 0)
    poses = search.find_poses(query(seen, mixed), count=5)
    assert np.isfinite(poses).all()


def test_pose_voted_for_beside_the_right_one_is_fitted_until_it_is_right(monkeypatch: pytest.MonkeyPatch) -> None:
    positions, labels = town()
    search = searched(positions, labels)
    rng = np.random.default_rng(3)
    errors_m = []
    for _ in range(10):
        seen, rows, T_gt = observed(positions, rng)
        T_beside = T_gt @ pose_at(1.4, 1.0, yaw=0.05)
        monkeypatch.setattr("slam.place_recognition.place_search.vote_for_poses", lambda *_, T=T_beside, **__: T[None])
        (fitted,) = search.find_poses(query(seen, labels[rows]), map_sigma_m=SIGMA_M, count=1)
        errors_m.append(float(np.linalg.norm((fitted - T_gt)[:2, 3])))
    assert max(errors_m) < 0.3


def test_objects_are_met_no_farther_than_the_next_object_of_the_map() -> None:
    """Two metres apart; those of the query are one and three metres off, and known to five."""
    row = np.column_stack([2.0 * np.arange(10), np.zeros((10, 2))])
    search = searched(row, np.zeros(10, int))
    positions = np.array([[4.0, 1.0, 0.0], [8.0, 3.0, 0.0]])
    asked = _query(positions, np.zeros(2, int), np.full(2, 5.0))
    apart_m, _ = search._met(np.array([[asked.middle], [1.0]]), asked, np.full(2, 5.0))
    np.testing.assert_allclose(apart_m, [[1.0, np.inf]], atol=1e-6)


def test_objects_near_a_place_are_of_all_classes() -> None:
    positions, labels = town(500, classes=3)
    search = searched(positions, labels, 3)
    for place in positions[[0, 100], :2] + 3.0:
        apart_m = np.linalg.norm(positions[:, :2] - place, axis=1)
        np.testing.assert_array_equal(search.near(place, 40.0), np.flatnonzero(apart_m <= 40.0))
    assert len(search.near(np.array([-1e4, 0.0]), 40.0)) == 0


def test_an_object_meets_another_of_its_class_only() -> None:
    positions, labels = town(500, classes=2)
    search = searched(positions, labels, 2)
    near = query(positions[:20], labels[:20])
    exchanged = query(positions[:20], 1 - labels[:20])
    assert search.count_met(near, np.eye(4)[None]).tolist() == [20]
    assert search.count_met(exchanged, np.eye(4)[None])[0] < 5
