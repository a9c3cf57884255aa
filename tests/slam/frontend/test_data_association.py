"""The assignment of detections to landmarks, against brute force and on cases whose answer is plain."""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.stats import chi2

from slam.common.arrays import FloatArray
from slam.common.calibration import ObjectCalibration
from slam.frontend import data_association
from slam.frontend.data_association import (
    AMBIGUOUS,
    INCONSISTENT_SIGMAS,
    NEW,
    Assignment,
    Objects,
    associate,
    density,
    label_likelihood,
    other_shares,
)
from tests.helpers.landmarks import spheres

CONFIG = ObjectCalibration(spacing_m=0.01)
SIGMA_M = 0.2
MATCH_GATE, NEW_OBJECT_GATE = chi2.ppf([0.9995, 0.999999], 3)
GATE_M = SIGMA_M * np.sqrt(2.0 * MATCH_GATE)
OUTER_GATE_M = SIGMA_M * np.sqrt(2.0 * NEW_OBJECT_GATE)


@dataclass
class Scene:
    seen: Objects
    positions: FloatArray
    covariances: FloatArray
    beliefs: FloatArray

    def assigned(self, config: ObjectCalibration = CONFIG) -> Assignment:
        return associate(self.seen, self.positions, self.covariances, self.beliefs, config)

    def rows(self, config: ObjectCalibration = CONFIG) -> list[int]:
        return [int(row) for row in self.assigned(config).landmark_rows]


def random_covariances(rng: np.random.Generator, count: int, sigma_m: float) -> FloatArray:
    A = rng.normal(scale=sigma_m, size=(count, 3, 3))
    return A @ np.swapaxes(A, 1, 2) + 0.1 * sigma_m**2 * np.eye(3)


def random_scene(rng: np.random.Generator, detections: int, landmarks: int) -> Scene:
    """Crowded enough that greedy choices are often wrong."""
    places = [rng.uniform(-2.0, 2.0, (count, 3)) * [1.0, 1.0, 0.2] for count in (detections, landmarks)]
    P = random_covariances(rng, detections, 0.5), random_covariances(rng, landmarks, 0.4)
    beliefs = rng.dirichlet(np.full(3, 0.3), size=landmarks)
    return Scene(Objects(places[0], P[0], rng.integers(3, size=detections)), places[1], P[1], beliefs)


def plain_scene(seen, landmarks, *, labels=None, beliefs=None) -> Scene:
    """Detections and landmarks (N,) along x or (N, 3) m, of two classes, all of the first one unless given."""
    places = [np.array(each, float) for each in (seen, landmarks)]
    places = [each if each.ndim == 2 else np.column_stack([each, np.zeros((len(each), 2))]) for each in places]
    D, L = map(len, places)
    P = [spheres(SIGMA_M, count) for count in (D, L)]
    labels = np.zeros(D, int) if labels is None else np.array(labels)
    beliefs = np.tile([1.0, 0.0], (L, 1)) if beliefs is None else np.array(beliefs)
    return Scene(Objects(places[0], P[0], labels), places[1], P[1], beliefs)


# Against brute force


def pair(scene: Scene, d: int, row: int) -> tuple[float, float]:
    """Squared distance of a pair, and its log-likelihood against that of an object of no landmark."""
    S = scene.seen.covariances[d] + scene.covariances[row]
    v = scene.seen.positions[d] - scene.positions[row]
    squared = float(v @ np.linalg.inv(S) @ v)
    label, classes = scene.seen.labels[d], scene.beliefs.shape[1]
    right = scene.beliefs[row, label]
    likelihood = right * CONFIG.label_accuracy + (1 - right) * (1 - CONFIG.label_accuracy) / (classes - 1)
    likelihood *= np.exp(-0.5 * squared) / np.sqrt(np.linalg.det(2 * np.pi * S))
    (share,) = other_shares(np.array([label]), np.array([row]), scene.beliefs)
    return squared, float(np.log(likelihood / (CONFIG.new_object_density * share)))


def gain_of(rows: tuple[int, ...], scene: Scene) -> float:
    """Log-likelihood ratio of an assignment against none; -inf: a pair outside the gate."""
    pairs = [pair(scene, d, row) for d, row in enumerate(rows) if row >= 0]
    if any(squared > MATCH_GATE for squared, _ in pairs):
        return -np.inf
    return sum(ratio for _, ratio in pairs)


def is_bad_measurement(scene: Scene, d: int) -> bool:
    """Whether a landmark of the detection's class is within the outer gate, and as wide as its noise then must be, it
    is likelier than a new object.
    """
    for row in range(len(scene.positions)):
        squared, ratio = pair(scene, d, row)
        widening = max(squared / 3.0, 1.0)
        tail = ratio + 0.5 * squared - 0.5 * squared / widening - 1.5 * np.log(widening)
        is_like = scene.beliefs[row, scene.seen.labels[d]] >= 0.5
        if is_like and squared <= NEW_OBJECT_GATE and tail > 0.0:
            return True
    return False


def all_assignments(detections: int, landmarks: int) -> Iterator[tuple[int, ...]]:
    for rows in itertools.product(range(-1, landmarks), repeat=detections):
        taken = [row for row in rows if row >= 0]
        if len(set(taken)) == len(taken):
            yield rows


@pytest.mark.parametrize("seed", range(15))
def test_no_assignment_is_more_likely_than_the_one_found(seed: int) -> None:
    rng = np.random.default_rng(seed)
    scene = random_scene(rng, int(rng.integers(1, 6)), int(rng.integers(1, 5)))
    found = scene.assigned()
    every = all_assignments(len(found.landmark_rows), len(scene.positions))
    best = max(every, key=lambda rows: gain_of(rows, scene))
    assert tuple(np.where(found.matched, found.landmark_rows, NEW).tolist()) == best
    assert found.log_likelihood_ratio == pytest.approx(gain_of(best, scene))
    for d, row in enumerate(found.landmark_rows.tolist()):
        assert row >= 0 or (row == AMBIGUOUS) is is_bad_measurement(scene, d)


@pytest.mark.parametrize("seed", range(3))
def test_sparse_and_dense_solvers_agree(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = random_scene(np.random.default_rng(seed), 40, 30)
    few = scene.rows()
    monkeypatch.setattr(data_association, "FEW_DISTANCES", 0)
    assert scene.rows() == few


# Plain cases


@pytest.mark.parametrize(("detections", "landmarks"), [(0, 0), (0, 3), (3, 0)])
def test_no_match_without_detections_or_landmarks(detections: int, landmarks: int) -> None:
    found = random_scene(np.random.default_rng(0), detections, landmarks).assigned()
    assert found.landmark_rows.tolist() == [NEW] * detections
    assert found.landmark_rows.dtype == np.int64
    assert not found.is_contested


@pytest.mark.parametrize(("factor", "row"), [(0.999, 0), (1.001, AMBIGUOUS)])
def test_gate_is_that_of_the_chi_squared_distribution(factor: float, row: int) -> None:
    assert plain_scene([factor * GATE_M], [0]).rows(ObjectCalibration(new_object_density=1e-12)) == [row]


@pytest.mark.parametrize(("factor", "row"), [(0.999, AMBIGUOUS), (1.001, NEW)])
def test_detection_is_new_only_outside_the_outer_gate(factor: float, row: int) -> None:
    scene = plain_scene([factor * OUTER_GATE_M], [0, -50])
    assignment = scene.assigned(ObjectCalibration(new_object_density=1e-6))
    assert assignment.landmark_rows.tolist() == [row]
    assert not assignment.matched[0]


@pytest.mark.parametrize("factor", [1.001, 10.0])
def test_where_labels_are_identities_there_is_no_outer_gate(factor: float) -> None:
    scene = plain_scene([factor * OUTER_GATE_M], [0, -50])
    assert scene.rows(ObjectCalibration(new_object_density=1e-9, spacing_m=51.0)) == [AMBIGUOUS]
    assert scene.rows(ObjectCalibration(new_object_density=1e-9, spacing_m=49.0)) == [NEW]


# Labels


def test_share_of_a_label_counts_the_other_landmarks_that_have_it() -> None:
    """Nineteen of 20 landmarks have the first of 4 classes, one the second, none the others."""
    beliefs = np.eye(4)[[0] * 19 + [1]]
    common, own, other, unseen = other_shares(np.array([0, 1, 1, 2]), np.array([3, 19, 3, 3]), beliefs)
    assert common == pytest.approx(18.25 / 20)
    assert own == pytest.approx(0.25 / 20)
    assert other == pytest.approx(1.25 / 20)
    assert own <= unseen <= 0.3


def test_single_class_is_never_wrong() -> None:
    np.testing.assert_array_equal(label_likelihood(np.ones(2), 1, CONFIG), 1.0)
    assert plain_scene([0.0], [0.1], beliefs=np.ones((1, 1))).rows() == [0]


# What is contested


@pytest.mark.parametrize(
    ("seen", "landmarks", "is_contested"),
    [([0.0], [0.4, -0.4], True), ([0.2, -0.2], [0.0], True), ([0.0, 9.0], [0.2, 9.2], False)],
    ids=["two landmarks", "two detections", "apart"],
)
def test_pairs_that_compete_are_contested(seen: list[float], landmarks: list[float], is_contested: bool) -> None:
    assert plain_scene(seen, landmarks).assigned().is_contested is is_contested


@pytest.mark.parametrize(("classes", "is_contested"), [(2, True), (10, True), (50, False)])
def test_landmark_is_no_rival_if_its_label_excludes_it(classes: int, is_contested: bool) -> None:
    """Of many classes, a wrong label is seldom just that of the neighbour."""
    beliefs = np.eye(classes)[:2]
    assert plain_scene([0.0], [0.2, -0.2], labels=[0], beliefs=beliefs).assigned().is_contested is is_contested


@pytest.mark.parametrize(("sigma_m", "is_uncertain"), [(1.0, True), (0.01, False)])
def test_assignment_is_uncertain_where_landmarks_are_less_certain_than_detections(
    sigma_m: float, is_uncertain: bool
) -> None:
    scene = plain_scene([0.0, 5.0], [0.1, 5.1])
    scene.covariances = scene.covariances * (sigma_m / SIGMA_M) ** 2
    assert scene.assigned().is_uncertain is is_uncertain


@pytest.mark.parametrize(("factor", "is_inconsistent"), [(0.99, False), (1.01, True)])
def test_assignment_is_inconsistent_by_the_sum_of_squared_distances(factor: float, is_inconsistent: bool) -> None:
    """One of twenty detections is outside the gate, and counts as if it was there."""
    most, places = 20 * 3.0 + INCONSISTENT_SIGMAS * np.sqrt(20 * 6.0), 100.0 * np.arange(20)
    squared = np.append(1.1 * MATCH_GATE, np.full(19, factor * (most - MATCH_GATE) / 19.0))
    scene = plain_scene(places + SIGMA_M * np.sqrt(2.0 * squared), places)
    assert scene.assigned(ObjectCalibration(new_object_density=1e-12)).is_inconsistent == is_inconsistent


# Parts


def test_density_is_that_of_objects_in_a_cylinder() -> None:
    rng = np.random.default_rng(0)
    positions = rng.uniform(-50.0, 50.0, (4000, 3)) * [1.0, 1.0, 0.1]
    positions = positions[np.linalg.norm(positions[:, :2], axis=1) < 50.0]
    assert density(positions, 0.1**2 * np.eye(3 * len(positions))) == pytest.approx(
        len(positions) / (np.pi * 50.0**2 * 10.0), rel=0.05
    )


def test_density_of_a_single_object_is_that_of_its_noise() -> None:
    spread_m = np.sqrt(2.0 * np.pi * np.e) * 0.3
    found = density(np.zeros((1, 3)), 0.09 * np.eye(3))
    assert found == pytest.approx(1.0 / (np.pi * spread_m**3))
