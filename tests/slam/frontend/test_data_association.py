"""The assignment of detections to landmarks, against brute force and on cases whose answer is plain."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.stats import chi2

from slam.common.arrays import FloatArray, IntArray
from slam.common.calibration import ObjectCalibration
from slam.frontend import data_association
from slam.frontend.data_association import (
    AMBIGUOUS,
    GATE_PROBABILITY,
    NEW,
    NEW_OBJECT_GATE_PROBABILITY,
    associate,
    label_likelihood,
    squared_distances,
)

CONFIG = ObjectCalibration()
Scene = tuple[FloatArray, FloatArray, IntArray, FloatArray, FloatArray, FloatArray]


def covariances(rng: np.random.Generator, count: int, sigma_m: float) -> FloatArray:
    A = rng.normal(scale=sigma_m, size=(count, 3, 3))
    return A @ np.swapaxes(A, 1, 2) + 0.1 * sigma_m**2 * np.eye(3)


def random_scene(rng: np.random.Generator, detections: int, landmarks: int, *, classes: int = 3) -> Scene:
    """Crowded enough that greedy choices are often wrong."""
    beliefs = rng.dirichlet(np.full(classes, 0.3), size=landmarks)
    return (
        rng.uniform(-2.0, 2.0, (detections, 3)) * [1.0, 1.0, 0.2],
        covariances(rng, detections, 0.5),
        rng.integers(classes, size=detections),
        rng.uniform(-2.0, 2.0, (landmarks, 3)) * [1.0, 1.0, 0.2],
        covariances(rng, landmarks, 0.4),
        beliefs,
    )


def plain_scene(positions, landmark_positions, *, labels=None, beliefs=None, sigma_m=0.2) -> Scene:
    positions, landmark_positions = np.array(positions, dtype=float), np.array(landmark_positions, dtype=float)
    D, L = len(positions), len(landmark_positions)
    return (
        positions.reshape(-1, 3),
        np.tile(sigma_m**2 * np.eye(3), (D, 1, 1)),
        np.zeros(D, dtype=np.int64) if labels is None else np.array(labels),
        landmark_positions.reshape(-1, 3),
        np.tile(sigma_m**2 * np.eye(3), (L, 1, 1)),
        np.tile([1.0, 0.0], (L, 1)) if beliefs is None else np.array(beliefs),
    )


def cost_of(rows: tuple[int, ...] | IntArray, scene: Scene) -> float:
    """Twice the negative log-likelihood of an assignment, pair by pair; inf: outside the gate."""
    positions, P, labels, landmark_positions, P_landmark, beliefs = scene
    classes = beliefs.shape[1]
    total = 0.0
    for d, row in enumerate(rows):
        if row < 0:
            total += -2.0 * np.log(CONFIG.new_object_density / classes)
            continue
        S = P[d] + P_landmark[row]
        v = positions[d] - landmark_positions[row]
        squared = v @ np.linalg.inv(S) @ v
        if squared > chi2.ppf(GATE_PROBABILITY, 3):
            return np.inf
        right = beliefs[row, labels[d]]
        label = right * CONFIG.label_accuracy + (1 - right) * (1 - CONFIG.label_accuracy) / (classes - 1)
        total += squared + np.log(np.linalg.det(2 * np.pi * S)) - 2 * np.log(label)
    return float(total)


def is_near_its_like(d: int, scene: Scene) -> bool:
    """Whether some landmark that is likely of the detection's class lies within the outer gate."""
    positions, P, labels, landmark_positions, P_landmark, beliefs = scene
    limit = chi2.ppf(NEW_OBJECT_GATE_PROBABILITY, 3)
    for row in range(len(landmark_positions)):
        v = positions[d] - landmark_positions[row]
        if beliefs[row, labels[d]] >= 0.5 and v @ np.linalg.inv(P[d] + P_landmark[row]) @ v <= limit:
            return True
    return False


def all_assignments(detections: int, landmarks: int):
    for rows in itertools.product(range(-1, landmarks), repeat=detections):
        taken = [row for row in rows if row >= 0]
        if len(set(taken)) == len(taken):
            yield rows


@pytest.mark.parametrize("seed", range(25))
def test_no_assignment_is_more_likely_than_the_one_found(seed):
    rng = np.random.default_rng(seed)
    scene = random_scene(rng, int(rng.integers(1, 6)), int(rng.integers(1, 5)))
    found = associate(*scene, CONFIG).landmark_rows
    every = list(all_assignments(len(scene[0]), len(scene[3])))
    best = min(every, key=lambda rows: cost_of(rows, scene))
    np.testing.assert_allclose(cost_of(found, scene), cost_of(best, scene), rtol=1e-9)
    assert tuple(np.where(found >= 0, found, NEW).tolist()) == best
    assert [bool(row == AMBIGUOUS) for row in found] == [
        found[d] < 0 and is_near_its_like(d, scene) for d in range(len(found))
    ]


def test_the_cases_against_brute_force_are_not_trivial():
    rows = [associate(*random_scene(np.random.default_rng(seed), 5, 4), CONFIG).landmark_rows for seed in range(25)]
    matched = np.concatenate(rows) >= 0
    assert 0.2 < matched.mean() < 0.9
    assert {NEW, AMBIGUOUS} <= set(np.concatenate(rows).tolist())


@pytest.mark.parametrize(("detections", "landmarks"), [(0, 0), (0, 3), (3, 0)])
def test_nothing_on_one_side_gives_no_match(detections, landmarks):
    scene = random_scene(np.random.default_rng(0), detections, landmarks)
    assignment = associate(*scene, CONFIG)
    assert assignment.landmark_rows.tolist() == [-1] * detections
    assert assignment.landmark_rows.dtype == np.int64
    assert not assignment.matched.any()


@pytest.mark.parametrize(("factor", "matched"), [(0.999, True), (1.001, False)])
def test_the_gate_lies_where_the_chi_squared_distribution_says(factor, matched):
    dense = ObjectCalibration(new_object_density=1e-12)
    reach_m = np.sqrt(2 * 0.2**2 * chi2.ppf(GATE_PROBABILITY, 3))
    scene = plain_scene([[factor * reach_m, 0, 0]], [[0, 0, 0]])
    assert bool(associate(*scene, dense).matched[0]) is matched


@pytest.mark.parametrize(("factor", "row"), [(0.999, AMBIGUOUS), (1.001, NEW)])
def test_outside_the_gate_a_detection_is_new_only_from_the_outer_gate_on(factor, row):
    reach_m = np.sqrt(2 * 0.2**2 * chi2.ppf(NEW_OBJECT_GATE_PROBABILITY, 3))
    assignment = associate(*plain_scene([[factor * reach_m, 0, 0]], [[0, 0, 0]]), CONFIG)
    assert assignment.landmark_rows.tolist() == [row]
    assert assignment.new.tolist() == [row == NEW]
    assert not assignment.matched[0]


def test_near_a_landmark_of_another_class_a_detection_is_new():
    reach_m = np.sqrt(2 * 0.2**2 * chi2.ppf(GATE_PROBABILITY, 3))
    scene = plain_scene([[1.1 * reach_m, 0, 0]], [[0, 0, 0]], labels=[1])
    assert associate(*scene, CONFIG).landmark_rows.tolist() == [NEW]


def test_a_detection_right_on_its_landmark_is_matched():
    assert associate(*plain_scene([[3, 4, 0]], [[3, 4, 0]]), CONFIG).landmark_rows.tolist() == [0]


def test_of_two_landmarks_at_one_distance_the_label_decides():
    beliefs = [[0.9, 0.1], [0.1, 0.9]]
    for label in (0, 1):
        scene = plain_scene([[0, 0, 0]], [[0.3, 0, 0], [-0.3, 0, 0]], labels=[label], beliefs=beliefs)
        assert associate(*scene, CONFIG).landmark_rows.tolist() == [label]


def test_with_one_class_no_label_is_wrong():
    np.testing.assert_array_equal(label_likelihood(np.array([1.0, 1.0]), 1, CONFIG), [1.0, 1.0])
    positions, P, labels, landmark_positions, P_landmark, _ = plain_scene([[0, 0, 0]], [[0.1, 0, 0]])
    one = associate(positions, P, labels, landmark_positions, P_landmark, np.ones((1, 1)), CONFIG)
    assert one.landmark_rows.tolist() == [0]


def test_label_likelihoods_of_all_labels_sum_to_one():
    beliefs = np.random.default_rng(0).dirichlet(np.ones(5), size=7)
    np.testing.assert_allclose(label_likelihood(beliefs, 5, CONFIG).sum(axis=1), 1.0)


def test_twins_a_metre_apart_keep_their_own_detections():
    """Both detections lie nearer to the second twin, but it can have only one of them."""
    scene = plain_scene([[0.55, 0, 0], [1.1, 0, 0]], [[0, 0, 0], [1, 0, 0]])
    assert associate(*scene, CONFIG).landmark_rows.tolist() == [0, 1]


def test_what_is_nobodys_stays_nobodys():
    scene = plain_scene([[0.1, 0, 0], [50, 0, 0]], [[0, 0, 0], [-50, 0, 0]])
    assert associate(*scene, CONFIG).landmark_rows.tolist() == [0, -1]


def test_a_denser_world_gives_fewer_matches():
    scene = plain_scene([[0.7, 0, 0]], [[0, 0, 0]])
    assert associate(*scene, ObjectCalibration(new_object_density=1e-4)).matched[0]
    assert not associate(*scene, ObjectCalibration(new_object_density=1.0)).matched[0]


@pytest.mark.parametrize("seed", range(10))
def test_the_order_of_detections_and_landmarks_does_not_matter(seed):
    rng = np.random.default_rng(seed)
    positions, P, labels, landmark_positions, P_landmark, beliefs = random_scene(rng, 30, 25)
    found = associate(positions, P, labels, landmark_positions, P_landmark, beliefs, CONFIG).landmark_rows
    assert (found >= 0).any()
    d, m = rng.permutation(30), rng.permutation(25)
    shuffled = associate(
        positions[d], P[d], labels[d], landmark_positions[m], P_landmark[m], beliefs[m], CONFIG
    ).landmark_rows
    np.testing.assert_array_equal(np.where(shuffled >= 0, m[shuffled], shuffled), found[d])


@pytest.mark.parametrize("seed", range(10))
def test_many_contested_pairs_are_assigned_as_few_are(seed, monkeypatch):
    scene = random_scene(np.random.default_rng(seed), 40, 30)
    few = associate(*scene, CONFIG)
    monkeypatch.setattr(data_association, "_partners", data_association._partners_of_many)
    many = associate(*scene, CONFIG)
    np.testing.assert_array_equal(many.landmark_rows, few.landmark_rows)
    assert few.matched.any()


def test_five_thousand_detections_find_their_landmarks_and_none_is_taken_twice():
    rng = np.random.default_rng(0)
    landmarks = np.concatenate([rng.uniform(-300, 300, (5000, 2)), np.zeros((5000, 1))], axis=1)
    order = rng.permutation(5000)
    detections = landmarks[order] + rng.normal(scale=0.05, size=(5000, 3))
    found = associate(*plain_scene(detections, landmarks, sigma_m=0.05), CONFIG).landmark_rows
    assert len(np.unique(found[found >= 0])) == np.count_nonzero(found >= 0)
    assert np.mean(found == order) > 0.99


@pytest.mark.parametrize("count", [0, 1, 50])
def test_distances_and_determinants_are_those_of_lapack(count):
    rng = np.random.default_rng(3)
    factors = rng.normal(size=(count, 3, 3)) * [1.0, 0.3, 5.0]
    covariances, offsets = factors @ factors.transpose(0, 2, 1) + 1e-3 * np.eye(3), rng.normal(size=(count, 3))
    distances, determinants = squared_distances(offsets, covariances)
    solved = np.linalg.solve(covariances, offsets[..., None])[..., 0]
    assert np.allclose(distances, np.einsum("ni,ni->n", offsets, solved), rtol=1e-6)
    assert np.allclose(determinants, np.linalg.det(covariances), rtol=1e-6)
