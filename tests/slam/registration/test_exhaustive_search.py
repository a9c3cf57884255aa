"""Every pair against every pair: finds the pose that is there, as a loop over all pairs does, and says when none is."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest

from slam.common.arrays import FloatArray, IntArray
from slam.common.errors import GeometryError
from slam.common.geometry import apply, invert, make_transform, transform_from_xyz_yaw, yaw_rad
from slam.registration import exhaustive_search
from slam.registration.class_raster import make_class_raster
from slam.registration.estimate import Registration
from slam.registration.exhaustive_search import ExhaustiveSearch
from slam.registration.parameters import RegistrationConfig
from slam.registration.registration import refine_many

CONFIG = RegistrationConfig()
SCALING = RegistrationConfig(estimate_scale=True)
MAP_SIGMA_M = 0.05


def scattered(count: int, *, seed: int, extent_m: float = 400.0, classes: int = 5) -> tuple[FloatArray, IntArray]:
    rng = np.random.default_rng(seed)
    heights = rng.normal(0.0, 0.5, (count, 1))
    return np.hstack([rng.uniform(0.0, extent_m, (count, 2)), heights]), rng.integers(0, classes, count)


def search(positions: FloatArray, labels: IntArray, config: RegistrationConfig = CONFIG) -> ExhaustiveSearch:
    return ExhaustiveSearch(positions, labels, config, map_sigmas=np.full(len(positions), MAP_SIGMA_M))


def seen_from(
    T_map_query: FloatArray, positions: FloatArray, labels: IntArray, radius_m: float = 30.0
) -> tuple[FloatArray, IntArray, IntArray]:
    """Positions about the sensor, labels, and which objects of the map they are."""
    near = np.flatnonzero(np.hypot(*(positions[:, :2] - T_map_query[:2, 3]).T) < radius_m)
    return apply(invert(T_map_query), positions[near]), labels[near], near


def localize(
    searched: ExhaustiveSearch, positions: FloatArray, labels: IntArray, *, per_m: float = 0.0
) -> Registration:
    sigmas = 0.05 + per_m * np.linalg.norm(positions, axis=1)
    return searched.localize(positions, labels, query_sigmas=sigmas)


def assert_at(answer: Registration, T_gt: FloatArray, *, metres: float = 0.01, degrees: float = 0.1) -> None:
    assert answer.found, answer.reason
    assert np.linalg.norm((answer.T_reference_query - T_gt)[:3, 3]) < metres
    assert abs(np.degrees(yaw_rad(invert(T_gt) @ answer.T_reference_query))) < degrees


def noisy(positions: FloatArray, rng: np.random.Generator, per_m: float = 0.05) -> FloatArray:
    return positions + rng.normal(0.0, 1.0, positions.shape) * per_m * np.linalg.norm(positions, axis=1, keepdims=True)


@pytest.mark.parametrize("origin_m", [(0.0, 0.0, 0.0), (1e5, -1e5, 700.0)])
def test_a_query_without_noise_is_found_exactly(origin_m):
    positions, labels = scattered(700, seed=0)
    positions = positions + origin_m
    searched = search(positions, labels)
    rng = np.random.default_rng(1)
    for _ in range(10):
        place = np.array([*rng.uniform(30.0, 370.0, 2), 1.5]) + origin_m
        T = transform_from_xyz_yaw(place, rng.uniform(-np.pi, np.pi))
        query, query_labels, objects = seen_from(T, positions, labels)
        answer = localize(searched, query, query_labels)
        assert_at(answer, T)
        assert answer.pairs.tolist() == [[i, which] for i, which in enumerate(objects)]
        assert answer.score == pytest.approx(len(query))


def test_objects_that_are_missing_added_or_of_another_class_do_not_matter():
    positions, labels = scattered(700, seed=2)
    searched = search(positions, labels)
    rng = np.random.default_rng(3)
    for _ in range(10):
        T = transform_from_xyz_yaw(np.array([*rng.uniform(30.0, 370.0, 2), 0.0]), rng.uniform(-np.pi, np.pi))
        query, query_labels, _ = seen_from(T, positions, labels)
        kept = rng.random(len(query)) < 0.7
        query, query_labels = query[kept], query_labels[kept].copy()
        wrong = rng.permutation(len(query))[: len(query) // 4]
        query_labels[wrong] = (query_labels[wrong] + 1) % 5
        query = np.vstack([query, rng.uniform(-20.0, 20.0, (3, 3)) * [1.0, 1.0, 0.0]])
        query_labels = np.append(query_labels, rng.integers(0, 7, 3))  # two of seven classes the map lacks
        assert_at(localize(searched, query, query_labels), T)


def test_three_objects_of_one_class_are_found_whichever_comes_first():
    positions, labels = scattered(60, seed=15, extent_m=150.0, classes=1)
    searched = search(positions, labels)
    rng = np.random.default_rng(16)
    for _ in range(30):
        three = np.array([0, *rng.permutation(np.arange(1, 6))[:2]])
        near = np.argsort(np.hypot(*(positions[:, :2] - positions[rng.integers(60), :2]).T))[three]
        T = transform_from_xyz_yaw(positions[near[0]] + [3.0, 2.0, 0.0], rng.uniform(-np.pi, np.pi))
        answer = localize(searched, apply(invert(T), positions[near]), labels[near])
        # Three objects may be elsewhere, too, but nowhere better than where they are from.
        assert answer.score == pytest.approx(3.0, abs=0.2)


def test_noise_that_grows_with_the_range_leaves_the_place():
    positions, labels = scattered(700, seed=4)
    searched = search(positions, labels)
    rng = np.random.default_rng(5)
    for _ in range(10):
        T = transform_from_xyz_yaw(np.array([*rng.uniform(30.0, 370.0, 2), 0.0]), rng.uniform(-np.pi, np.pi))
        query, query_labels, _ = seen_from(T, positions, labels)
        answer = localize(searched, noisy(query, rng), query_labels, per_m=0.05)
        assert_at(answer, T, metres=2.0, degrees=6.0)


@pytest.mark.parametrize("factor", [0.92, 1.08])
def test_a_scale_is_estimated_where_configured(factor):
    positions, labels = scattered(700, seed=6)
    T = transform_from_xyz_yaw(np.array([200.0, 180.0, 0.0]), 2.0)
    query, query_labels, _ = seen_from(T, positions, labels)
    answer = localize(search(positions, labels, SCALING), query * factor, query_labels)
    assert_at(answer, T, metres=0.05)
    assert answer.scale == pytest.approx(1.0 / factor, abs=1e-3)
    rigid = localize(search(positions, labels), query * factor, query_labels)
    assert rigid.score < 0.7 * answer.score


def test_of_two_places_that_are_alike_either_is_right():
    positions, labels = scattered(200, seed=7, extent_m=200.0)
    away = np.array([1000.0, 300.0, 0.0])
    searched = search(np.vstack([positions, positions + away]), np.tile(labels, 2))
    T = transform_from_xyz_yaw(np.array([90.0, 110.0, 0.0]), -1.0)
    query, query_labels, _ = seen_from(T, positions, labels)
    answer = localize(searched, query, query_labels)
    other = T.copy()
    other[:3, 3] += away
    is_first = np.linalg.norm((answer.T_reference_query - T)[:3, 3]) < 500.0
    assert_at(answer, T if is_first else other)


def best_of_a_loop(query: FloatArray, query_labels: IntArray, positions: FloatArray, labels: IntArray) -> float:
    """The best score after refinement from each pair of the query on each pair of the map with the same labels."""
    poses = []
    for i, j in permutations(range(len(query)), 2):
        for a, b in permutations(range(len(positions)), 2):
            along, onto = query[j, :2] - query[i, :2], positions[b, :2] - positions[a, :2]
            longest = max(np.hypot(*along), np.hypot(*onto))
            if query_labels[i] != labels[a] or query_labels[j] != labels[b] or longest < 3.0:
                continue
            if abs(np.hypot(*along) - np.hypot(*onto)) > 6.0:
                continue
            turn = np.arctan2(onto[1], onto[0]) - np.arctan2(along[1], along[0])
            T = transform_from_xyz_yaw(np.zeros(3), turn)
            middles = (query[i] + query[j]) / 2.0, (positions[a] + positions[b]) / 2.0
            poses.append(make_transform(T[:3, :3], middles[1] - T[:3, :3] @ middles[0]))
    answers = refine_many(
        query,
        query_labels,
        positions,
        labels,
        np.array(poses),
        CONFIG,
        query_sigmas=0.05 + 0.03 * np.linalg.norm(query, axis=1),
        reference_sigmas=np.full(len(positions), MAP_SIGMA_M),
    )
    return max(answer.score for answer in answers)


@pytest.mark.parametrize("seed", range(8))
def test_no_loop_over_all_pairs_finds_a_better_pose(seed):
    rng = np.random.default_rng(seed)
    positions, labels = scattered(15, seed=100 + seed, extent_m=50.0, classes=2)
    query, query_labels, _ = seen_from(
        transform_from_xyz_yaw(np.array([25.0, 25.0, 0.0]), 1.0), positions, labels, 20.0
    )
    query = noisy(query, rng, 0.02)
    query_labels = np.where(rng.random(len(query)) < 0.2, 1 - query_labels, query_labels)
    found = localize(search(positions, labels), query, query_labels, per_m=0.03)
    assert found.score == pytest.approx(best_of_a_loop(query, query_labels, positions, labels), abs=1e-3)


def test_what_is_left_out_would_not_have_been_better(monkeypatch):
    positions, labels = scattered(700, seed=8)
    searched = search(positions, labels)
    rng = np.random.default_rng(9)
    queries = []
    for _ in range(6):
        T = transform_from_xyz_yaw(np.array([*rng.uniform(30.0, 370.0, 2), 0.0]), rng.uniform(-np.pi, np.pi))
        query, query_labels, _ = seen_from(T, positions, labels)
        wrong = rng.random(len(query)) < 0.2
        queries.append((noisy(query, rng, 0.03), np.where(wrong, (query_labels + 1) % 5, query_labels)))
    scores = [localize(searched, *query, per_m=0.04).score for query in queries]
    monkeypatch.setattr(exhaustive_search, "SURE_INLIERS", 10**6)
    monkeypatch.setattr(exhaustive_search, "OBJECTS_A_ROUND", 10**6)
    all_tried = [localize(searched, *query, per_m=0.04).score for query in queries]
    assert scores == pytest.approx(all_tried, abs=1e-3)


def test_the_same_query_has_the_same_answer_also_from_another_search():
    positions, labels = scattered(300, seed=10, classes=2)
    query, query_labels, _ = seen_from(transform_from_xyz_yaw(np.array([150.0, 220.0, 0.0]), 0.5), positions, labels)
    query = noisy(query, np.random.default_rng(0))
    searched = search(positions, labels)
    first = localize(searched, query, query_labels, per_m=0.05)
    for again in (searched, search(positions, labels)):
        answer = localize(again, query, query_labels, per_m=0.05)
        assert np.array_equal(answer.T_reference_query, first.T_reference_query)
        assert np.array_equal(answer.pairs, first.pairs)
        assert answer.score == first.score


@pytest.mark.parametrize(
    ("places", "labels", "reason"),
    [
        ([], [], "0 of the 0 objects"),
        ([[5.0, 0.0, 0.0]], [0], "1 of the 1 objects"),
        ([[5.0, 0.0, 0.0], [0.0, 9.0, 0.0], [7.0, 7.0, 0.0]], [8, 9, -1], "0 of the 3 objects"),
        ([[5.0, 0.0, 0.0], [5.1, 0.0, 0.0], [5.0, 0.2, 0.0]], [0, 1, 2], "no pair of the 3 objects"),
        ([[0.0, 0.0, 0.0], [900.0, 0.0, 0.0], [0.0, 900.0, 0.0]], [0, 1, 2], "no pair of the 3 objects"),
    ],
)
def test_what_cannot_be_localized_has_a_reason(places, labels, reason):
    positions, map_labels = scattered(40, seed=11, classes=3)
    query = np.array(places).reshape(-1, 3)
    answer = localize(search(positions, map_labels), query, np.array(labels, np.int64))
    assert not answer.found
    assert reason in answer.reason
    assert answer.score == 0.0
    assert len(answer.pairs) == 0


def test_two_objects_that_agree_are_too_few_unless_configured_otherwise():
    positions = np.array([[0.0, 0.0, 0.0], [12.0, 0.0, 0.0], [300.0, 0.0, 0.0]])
    labels = np.arange(3)
    T = transform_from_xyz_yaw(np.array([5.0, 3.0, 0.0]), 1.0)
    query = apply(invert(T), positions)
    query[2] = [5.0, 5.0, 0.0]
    answer = localize(search(positions, labels), query, labels)
    assert not answer.found
    assert "fewer than 3" in answer.reason
    assert_at(localize(search(positions, labels, RegistrationConfig(min_inliers=2)), query, labels), T)


def test_a_map_of_one_object_has_no_pair():
    answer = localize(search(np.zeros((1, 3)), np.zeros(1, np.int64)), 9.0 * np.eye(3), np.zeros(3, np.int64))
    assert "no pair" in answer.reason


def test_input_that_does_not_fit_is_refused():
    positions, labels = scattered(40, seed=12)
    searched = search(positions, labels)
    with pytest.raises(GeometryError, match="do not fit"):
        searched.localize(positions, labels[1:], query_sigmas=np.ones(40))
    with pytest.raises(GeometryError, match="sigma"):
        searched.localize(positions, labels, query_sigmas=np.zeros(40))
    with pytest.raises(GeometryError, match="not finite"):
        search(np.full((2, 3), np.nan), labels[:2])
    with pytest.raises(GeometryError, match="no objects"):
        search(np.zeros((0, 3)), labels[:0])


def test_the_raster_names_the_nearest_object_of_the_class():
    positions, labels = scattered(300, seed=13, classes=3)
    planar = positions[:, :2] - 200.0
    raster = make_class_raster(planar, labels, 3, reach_m=6.0, cell_m=0.5)
    at = np.random.default_rng(14).uniform(-300.0, 300.0, (5000, 2))
    for label in range(3):
        of_class = np.flatnonzero(labels == label)
        distances = np.linalg.norm(at[:, None] - planar[of_class], axis=2)
        order = np.sort(distances, axis=1)
        nearest = raster.nearest(label, at[:, 0] + 1j * at[:, 1])
        # Within a cell's diagonal of a border between two objects, or of the reach, it may be either.
        near = (order[:, 0] < 5.6) & (order[:, 1] - order[:, 0] > 0.75)
        assert near.sum() > 100
        assert np.array_equal(nearest[near], of_class[distances[near].argmin(axis=1)])
        assert np.all(nearest[order[:, 0] > 6.4] == len(planar))


def test_the_nearer_of_two_objects_in_one_cell_is_entered():
    planar = np.array([[0.02, 0.02], [0.23, 0.23], [0.11, 0.11]])
    raster = make_class_raster(planar, np.zeros(3, np.int64), 1, reach_m=6.0, cell_m=0.5)
    assert raster.nearest(0, np.array([-3.0 - 3.0j, 3.0 + 3.0j])).tolist() == [0, 1]


def test_a_map_across_half_the_world_is_refused():
    planar = np.array([[0.0, 0.0], [2e7, 1e7]])
    with pytest.raises(GeometryError, match="divide the map"):
        make_class_raster(planar, np.zeros(2, np.int64), 1, reach_m=6.0, cell_m=0.5)
