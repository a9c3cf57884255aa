"""Landmarks that stand at one place become one; whatever speaks for two keeps them apart."""

from __future__ import annotations

import numpy as np
import pytest

from slam.backend.factor_graph import FactorGraph
from slam.backend.factors import Edge, Observation
from slam.common.calibration import ObjectCalibration
from slam.loop_closure.landmark_fusion import fuse_duplicate_landmarks
from slam.object_map.landmarks import ObjectMap
from tests.helpers.graphs import chained, observed_from, odometry_edges
from tests.helpers.landmarks import add_landmarks
from tests.helpers.poses import pose_at

KEYFRAMES = 6
SURE = 1e-6 * np.eye(6)
SEEN = 0.1**2 * np.eye(3)
Seen = tuple[str, tuple[float, float, float], tuple[int, ...]]
"""Class, place in the map and observing keyframes of a landmark."""


def mapped(landmarks: list[Seen], tentative: tuple[int, ...] = ()) -> tuple[ObjectMap, FactorGraph]:
    """A map of those landmarks, seen without noise along a straight street."""
    object_map, T = ObjectMap(ObjectCalibration()), np.array([pose_at(2.0 * k) for k in range(KEYFRAMES)])
    graph = chained(T[0], odometry_edges(T, SURE))
    places = np.array([place for _, place, _ in landmarks])
    rows = add_landmarks(object_map, places, [label for label, _, _ in landmarks], confirmed=False)
    object_map.confirm(np.setdiff1d(rows, tentative))
    for row, (_, _, keyframes) in enumerate(landmarks):
        for k in keyframes:
            graph.add_observations(observed_from(k, T[k], places, [row], SEEN))
    graph.optimize()
    return object_map, graph


def found(landmarks: list[Seen], keyframes: range = range(KEYFRAMES), **more: tuple[int, ...]) -> list[tuple[int, int]]:
    object_map, graph = mapped(landmarks, **more)
    assert fuse_duplicate_landmarks(object_map, graph, keyframes, radius_m=0.7) == len(object_map.aliases)
    return [(kept, dropped) for dropped, kept in object_map.aliases.items()]


FIRST: Seen = ("tree", (5.0, 4.0, 0.0), (0, 1, 2))


def test_one_object_that_two_passes_saw_is_one() -> None:
    assert found([FIRST, ("tree", (5.3, 3.8, 0.2), (3, 4))]) == [(0, 1)]


@pytest.mark.parametrize(
    "other",
    [
        pytest.param(("lamp", (5.3, 3.8, 0.2), (3, 4)), id="another class"),
        pytest.param(("tree", (5.8, 4.0, 0.2), (3, 4)), id="too far"),
        pytest.param(("tree", (5.3, 3.8, 1.5), (3, 4)), id="above it"),
        pytest.param(("tree", (5.3, 3.8, 0.2), (2, 3)), id="seen beside it"),
    ],
)
def test_twin_what_speaks_for_two_keeps_two(other: Seen) -> None:
    assert found([FIRST, other]) == []


def test_a_drive_with_two_landmarks_does_not_keep_two_of_all_drives() -> None:
    landmarks = [("tree", (5.0, 4.0, 0.0), (0, 1, 2, 4)), ("tree", (5.3, 3.8, 0.2), (2,))]
    object_map, graph = mapped(landmarks)
    every, drives = range(KEYFRAMES), np.arange(KEYFRAMES)
    assert fuse_duplicate_landmarks(object_map, graph, every, radius_m=0.7) == 0
    assert fuse_duplicate_landmarks(object_map, graph, every, radius_m=0.7, drives=drives) == 1


@pytest.mark.parametrize(
    "seen",
    [
        pytest.param(((0, 1, 2, 3), (0, 1, 2)), id="most drives have both"),
        pytest.param(((0, 1, 2, 3, 4), (3, 4)), id="it came later"),
        pytest.param(((0, 1, 2, 3, 4), (0, 1)), id="it went"),
    ],
)
def test_twin_what_most_drives_that_passed_saw_beside_another_is_two(seen: tuple[tuple[int, ...], ...]) -> None:
    landmarks = [("tree", (5.0, 4.0, 0.0), seen[0]), ("tree", (5.3, 3.8, 0.2), seen[1])]
    drives = np.arange(KEYFRAMES)
    assert fuse_duplicate_landmarks(*mapped(landmarks), range(KEYFRAMES), radius_m=0.7, drives=drives) == 0


def test_what_is_not_confirmed_or_not_well_placed_is_left() -> None:
    pair = [FIRST, ("tree", (5.3, 3.8, 0.2), (3, 4))]
    assert found(pair, tentative=(1,)) == []
    assert found(pair, keyframes=range(4)) == [(0, 1)]
    assert found(pair, keyframes=range(3)) == []


def test_only_nearest_neighbours_are_one_at_a_time() -> None:
    """The second is nearer to the third, which the first was seen beside."""
    landmarks = [FIRST, ("tree", (5.5, 4.0, 0.0), (3,)), ("tree", (5.6, 4.0, 0.0), (2, 4))]
    assert found(landmarks) == [(1, 2)]


def test_what_is_merged_is_compared_again_where_the_older_one_stands() -> None:
    """The third is 0.8 m from the second, and 0.6 m from the first."""
    parts = mapped([FIRST, ("tree", (5.0, 4.2, 0.0), (3,)), ("tree", (5.0, 3.4, 0.0), (4,))])
    assert fuse_duplicate_landmarks(*parts, range(KEYFRAMES), radius_m=0.7) == 2


def test_what_was_seen_beside_a_merged_landmark_is_another_object() -> None:
    parts = mapped([FIRST, ("tree", (5.1, 4.0, 0.0), (3,)), ("tree", (4.7, 4.0, 0.0), (3, 4))])
    assert fuse_duplicate_landmarks(*parts, range(KEYFRAMES), radius_m=0.7) == 1


def test_what_stays_as_it_is_is_not_merged_among_itself() -> None:
    object_map, _ = mapped([FIRST, ("tree", (5.3, 3.8, 0.2), (3, 4))])
    graph = FactorGraph()
    known = {0: np.array([5.0, 4, 0]), 1: np.array([5.3, 3.8, 0.2])}
    graph.add_known_landmarks(known, np.full(3, 1e-3), is_fixed=True)
    seen = [Observation(row, row, np.array([5.0, 4.0, 0.0]), SEEN) for row in (0, 1)]
    graph.restore(np.tile(np.eye(4), (2, 1, 1)), [Edge(0, 1, np.eye(4), np.eye(6), "odometry")], seen)
    assert fuse_duplicate_landmarks(object_map, graph, range(2), radius_m=0.7) == 0
