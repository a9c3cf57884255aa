"""Which inliers an answer has."""

from __future__ import annotations

import numpy as np

from slam.registration.estimate import estimate
from slam.registration.parameters import RegistrationConfig
from slam.registration.refinement import LevelPose, Pairs

SIGMAS_M = np.full(4, 0.3)


def test_an_inlier_that_the_last_fit_loses_is_none():
    gate_m = 3.0 * SIGMAS_M[0]
    corners = np.array([0.0, 20.0, 20.0j, 20.0 + 20.0j])
    moved = corners + np.array([0.0, 1.2 * gate_m, 0.0, 0.0])
    rows, flat, middle = np.column_stack([np.arange(4)] * 2), np.zeros(4), np.zeros(3)
    pairs = Pairs(rows, corners, moved, flat, flat, SIGMAS_M, SIGMAS_M, middle, middle)
    start = LevelPose(1.0, 0.25 * gate_m, 0.0)
    assert len(estimate(start, pairs, RegistrationConfig()).pairs) == 3
    assert estimate(start, pairs, RegistrationConfig(min_inliers=4)).reason == (
        "3 pairs of objects agree on a pose, fewer than 4"
    )
