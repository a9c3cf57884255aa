"""Segments are moved as a whole to where an edge puts them."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import L, X

from slam.backend.factors import Edge, EdgeKind
from slam.backend.segment_joining import moved_estimate, relaxed_breaks, shift_of_segment
from slam.common.geometry import invert
from tests.logs.examples import random_transform as random_pose

SURE = 1e-4 * np.eye(6)


@pytest.fixture
def poses():
    rng = np.random.default_rng(3)
    return [random_pose(rng) for _ in range(4)]


@pytest.fixture
def estimate(poses):
    values = gtsam.Values()
    for keyframe, T in enumerate(poses):
        values.insert(X(keyframe), gtsam.Pose3(T))
    for landmark in range(2):
        values.insert(L(landmark), np.array([landmark, 2.0, 3.0]))
    return values


@pytest.mark.parametrize("moved", [{2, 3}, {0, 1}])
def test_the_edge_holds_once_the_segment_is_moved(poses, moved):
    edge = Edge(1, 3, random_pose(np.random.default_rng(4)), SURE, EdgeKind.LOOP_CLOSURE)
    T_shift = shift_of_segment(edge, poses[1], poses[3], moved)
    T_from, T_to = (T_shift @ poses[each] if each in moved else poses[each] for each in (1, 3))
    np.testing.assert_allclose(invert(T_from) @ T_to, edge.T_from_to, atol=1e-9)


def test_only_what_belongs_to_the_segment_is_moved(poses, estimate):
    T_shift = random_pose(np.random.default_rng(5))
    values = moved_estimate(estimate, range(4), range(2), {2, 3}, {1}, T_shift)
    for keyframe, T in enumerate(poses):
        expected = T_shift @ T if keyframe >= 2 else T
        np.testing.assert_allclose(values.atPose3(X(keyframe)).matrix(), expected, atol=1e-9)
    np.testing.assert_array_equal(values.atPoint3(L(0)), estimate.atPoint3(L(0)))
    expected = T_shift[:3, :3] @ estimate.atPoint3(L(1)) + T_shift[:3, 3]
    np.testing.assert_allclose(values.atPoint3(L(1)), expected, atol=1e-9)


def test_only_breaks_at_the_ends_of_the_segment_say_what_the_estimate_says(poses, estimate):
    kinds = {0: (1, 2, EdgeKind.DISCONTINUITY), 1: (2, 3, EdgeKind.DISCONTINUITY), 2: (1, 2, EdgeKind.ODOMETRY)}
    factors = {number: Edge(first, last, np.eye(4), SURE, kind) for number, (first, last, kind) in kinds.items()}
    relaxed = relaxed_breaks(factors, {2, 3}, estimate)
    assert set(relaxed) == {0}
    np.testing.assert_allclose(relaxed[0].T_from_to, invert(poses[1]) @ poses[2], atol=1e-9)
