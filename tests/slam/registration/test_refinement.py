"""Which pairs of objects count in a refinement, and which inliers an answer has."""

from __future__ import annotations

import numpy as np
import pytest

from slam.common.arrays import FloatArray, IntArray
from slam.registration.estimate import estimate
from slam.registration.parameters import RegistrationConfig
from slam.registration.refinement import Columns, make_columns, refine_poses, support

SIGMA_M = 0.2
CONFIG = RegistrationConfig(height_sigma_m=0.05)
GATE_M = CONFIG.gate_sigma * np.hypot(SIGMA_M, SIGMA_M)
CORNERS = np.array([[0.0, 0.0, 0.0], [20.0, 0.0, 0.0], [0.0, 20.0, 0.0], [20.0, 20.0, 0.0], [9.0, 14.0, 0.0],
                    [-8.0, 6.0, 0.0]])  # fmt: skip


def columns(query: FloatArray, reference: FloatArray, pairs: IntArray) -> Columns:
    sigmas = np.full(len(query), SIGMA_M), np.full(len(reference), SIGMA_M)
    return make_columns(query, reference, pairs, *sigmas, CONFIG)


def offset_m(pose: FloatArray, made: Columns) -> float:
    """How far the pose (6,) is from the identity."""
    shift = pose[2:4] - (made.query_centre - made.reference_centre)[:2]
    return float(np.hypot(*shift))


def identity(made: Columns, off_m: float = 0.0) -> FloatArray:
    shift = made.query_centre - made.reference_centre
    return np.array([[1.0, 0.0, shift[0] + off_m, shift[1], shift[2], 1.0]])


@pytest.mark.parametrize("doubled", ["query", "reference"])
def test_an_object_counts_with_the_one_that_it_prefers_only(doubled):
    beside = CORNERS[1] + [0.4, 0.0, 0.0]
    count = len(CORNERS)
    same = np.column_stack([np.arange(count), np.arange(count)])
    more = np.concatenate([CORNERS, [beside]])
    if doubled == "query":
        made = columns(more, CORNERS, np.concatenate([same, [[count, 1]]]))
    else:
        made = columns(CORNERS, more, np.concatenate([same, [[1, count]]]))
    poses, _ = refine_poses(identity(made, 0.05), made, CONFIG, radius_m=CONFIG.search_radius_m)
    assert offset_m(poses[0], made) < 1e-4


def test_what_does_not_fit_in_the_end_does_not_count():
    reference = CORNERS.copy()
    reference[1] += [2.0, 0.0, 0.0]
    made = columns(CORNERS, reference, np.column_stack([np.arange(6), np.arange(6)]))
    poses, _ = refine_poses(identity(made, 0.3), made, CONFIG, radius_m=CONFIG.search_radius_m)
    assert offset_m(poses[0], made) < 1e-4


def test_two_objects_with_one_partner_support_a_pose_once():
    for pairs in ([[0, 0], [1, 0]], [[0, 0], [0, 1]]):
        made = columns(CORNERS[:2], CORNERS[:2], np.array(pairs))
        assert support(np.zeros((1, 2)), made).tolist() == [1.0]


def test_an_inlier_that_the_last_fit_loses_is_none():
    reference = CORNERS[:4].copy()
    reference[1] += [1.2 * GATE_M, 0.0, 0.0]
    made = columns(CORNERS[:4], reference, np.column_stack([np.arange(4), np.arange(4)]))
    start = identity(made, 0.25 * GATE_M)[0]
    assert len(estimate(start, made, CONFIG).pairs) == 3
    strict = RegistrationConfig(height_sigma_m=0.05, min_inliers=4)
    answer = estimate(start, made, strict)
    assert not answer.found
    assert answer.reason == "3 pairs of objects agree on a pose, fewer than 4"
