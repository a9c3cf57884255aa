"""Landmarks of one object are merged, those of two are not."""

import numpy as np
import pytest

from slam.backend.factor_graph import FactorGraph
from slam.backend.factors import Edge, Observation
from slam.common.arrays import FloatArray
from slam.common.calibration import ObjectCalibration
from slam.frontend.data_association import DECIDED
from slam.loop_closure.landmark_fusion import fuse_landmarks
from slam.object_map.landmarks import ObjectMap
from slam.odometry.noise import FREEDOM
from tests.helpers.graphs import chained, observed_from, odometry_edges
from tests.helpers.landmarks import add_landmarks
from tests.helpers.poses import pose_at

KEYFRAMES = 6
SURE = 1e-6 * np.eye(6)
SEEN = 0.1**2 * np.eye(3)
OBJECTS = ObjectCalibration(detection_probability=0.8)
Seen = tuple[str, tuple[float, float, float], tuple[int, ...]]
"""Class, place in the map and observing keyframes of a landmark."""


def mapped(
    landmarks: list[Seen], tentative: tuple[int, ...] = (), step: FloatArray = SURE
) -> tuple[ObjectMap, FactorGraph]:
    """A map of those landmarks, seen without noise along a straight street; ``step``: covariance of the odometry."""
    object_map, T = ObjectMap(ObjectCalibration()), np.array([pose_at(2.0 * k) for k in range(KEYFRAMES)])
    graph = chained(T[0], odometry_edges(T, step))
    places = np.array([place for _, place, _ in landmarks])
    rows = add_landmarks(object_map, places, [label for label, _, _ in landmarks], confirmed=False)
    object_map.confirm(np.setdiff1d(rows, tentative))
    for row, (_, _, keyframes) in enumerate(landmarks):
        for k in keyframes:
            graph.add_observations(observed_from(k, T[k], places, [row], SEEN))
    graph.optimize()
    return object_map, graph


def found(
    landmarks: list[Seen], tentative: tuple[int, ...] = (), step: FloatArray = SURE, config: ObjectCalibration = OBJECTS
) -> list[tuple[int, int]]:
    object_map, graph = mapped([*landmarks, *FAR], tentative, step)
    assert fuse_landmarks(object_map, graph, config) == len(object_map.aliases)
    return [(kept, dropped) for dropped, kept in object_map.aliases.items()]


FIRST: Seen = ("tree", (5.0, 4.0, 0.0), (0, 1, 2))
FAR: tuple[Seen, ...] = (("post", (-20.0, 9.0, 0.0), (0,)), ("post", (20.0, -9.0, 0.0), (5,)))
BESIDE: Seen = ("tree", (5.3, 3.8, 0.2), (3, 4))


def test_fuse_landmarks_merges_one_object_that_two_passes_saw() -> None:
    """Also where no scan has two objects of a class, and their density is that of all."""
    for config in (OBJECTS, OBJECTS.model_copy(update={"spacing_m": 1e4})):
        assert found([FIRST, BESIDE], config=config) == [(0, 1)]


@pytest.mark.parametrize(
    "other",
    [
        pytest.param(("lamp", (5.3, 3.8, 0.2), (3, 4)), id="another class"),
        pytest.param(("tree", (6.0, 4.0, 0.2), (3, 4)), id="too far"),
        pytest.param(("tree", (5.3, 3.8, 1.5), (3, 4)), id="above it"),
        pytest.param(("tree", (5.3, 3.8, 0.2), (2, 3)), id="seen beside it"),
    ],
)
def test_fuse_landmarks_keeps_two_objects(other: Seen) -> None:
    assert found([FIRST, other]) == []


@pytest.mark.parametrize(("factor", "is_merged"), [(0.99, False), (1.01, True)])
def test_fuse_landmarks_merges_two_from_the_spacing_on_at_which_one_object_is_decided(
    factor: float, is_merged: bool
) -> None:
    config = OBJECTS.model_copy(update={"landmark_sigma_m": 0.2, "landmark_height_sigma_m": 0.3})
    _, graph = mapped([FIRST, BESIDE, *FAR])
    S = graph.relative_covariances(np.array([[0, 1]]))[0] + np.diag([0.04, 0.04, 0.04 + 0.09])
    d = np.subtract(BESIDE[1], FIRST[1])
    tail = (1.0 + d @ np.linalg.solve(S, d) / FREEDOM) ** (-0.5 * (FREEDOM + 3.0))
    per_m2 = tail / (2.0 * np.pi * np.sqrt(np.linalg.det(S[:2, :2]))) / (1.0 - OBJECTS.detection_probability)
    spacing_m = factor * np.sqrt(np.log(2.0) / np.pi / (per_m2 / DECIDED * (1.0 - DECIDED)))
    is_found = found([FIRST, BESIDE], config=config.model_copy(update={"spacing_m": spacing_m})) == [(0, 1)]
    assert is_found == is_merged


def test_fuse_landmarks_knows_how_far_the_odometry_may_have_drifted() -> None:
    far, sparse = ("tree", (5.0, 2.5, 0.0), (5,)), OBJECTS.model_copy(update={"spacing_m": 20.0})
    assert found([FIRST, far], config=sparse) == []
    assert found([FIRST, far], config=sparse, step=0.2**2 * np.eye(6)) == [(0, 1)]


def test_fuse_landmarks_leaves_what_is_not_confirmed() -> None:
    assert found([FIRST, BESIDE], tentative=(1,)) == []


def test_fuse_landmarks_leaves_one_that_may_be_either_of_two() -> None:
    """The third was seen beside the first."""
    either = [FIRST, ("tree", (5.3, 4.0, 0.0), (3,)), ("tree", (5.6, 4.0, 0.0), (2, 4))]
    assert found(either) == []
    assert found(either[:2]) == [(0, 1)]


def test_fuse_landmarks_merges_three_of_one_object() -> None:
    passes = [FIRST, ("tree", (5.0, 4.1, 0.0), (3,)), ("tree", (5.0, 3.9, 0.0), (4,))]
    assert len(found(passes)) == 2


@pytest.mark.parametrize(("classes", "expected"), [(15, [(0, 15)]), (5, []), (1, [])])
def test_fuse_landmarks_takes_labels_for_identities_where_they_cannot_be_random(
    classes: int, expected: list[tuple[int, int]]
) -> None:
    """No scan has two objects of a class; the last landmark is 2 m from the first."""
    labels = [f"tag{number % classes}" for number in range(15)]
    seen = [(label, (5.0 + 4.0 * number, 4.0, 0.0), (0, 1, 2)) for number, label in enumerate(labels)]
    object_map, graph = mapped([*seen, ("tag0", (5.0, 2.0, 0.0), (4, 5))])
    fuse_landmarks(object_map, graph, OBJECTS.model_copy(update={"spacing_m": 1e4}))
    assert [(kept, dropped) for dropped, kept in object_map.aliases.items()] == expected


def test_fuse_landmarks_leaves_a_fixed_map_as_it_is() -> None:
    object_map, _ = mapped([FIRST, BESIDE])
    graph = FactorGraph()
    known = {0: np.array([5.0, 4, 0]), 1: np.array([5.3, 3.8, 0.2])}
    graph.add_known_landmarks(known, np.full(3, 1e-3), is_fixed=True)
    seen = [Observation(row, row, np.array([5.0, 4.0, 0.0]), SEEN) for row in (0, 1)]
    graph.restore(np.tile(np.eye(4), (2, 1, 1)), [Edge(0, 1, np.eye(4), np.eye(6), "odometry")], seen)
    assert fuse_landmarks(object_map, graph, OBJECTS) == 0
