"""Agreement of closures, the odometry penalty, and the joint score of several candidates."""

from __future__ import annotations

import numpy as np
import pytest

from slam.common.arrays import FloatArray
from slam.loop_closure.consistency import (
    AGREE_RAD,
    AGREE_RANGES,
    CLOSURE_SIGMA_RAD,
    odometry_penalty,
    poses_agree,
    suppress_non_maxima,
)
from slam.odometry.noise import SLIP_INFLATION
from tests.helpers.candidates import make_candidate
from tests.helpers.poses import pose_at

SIGMA_M = 0.35
"""Of a landmark between two traversals."""
RANGE_M = 30.0
DRIFT = (0.8, 0.02)
T_BASE = pose_at(40.0, -7.0, z=1.0, yaw=2.5)


def moved(T: FloatArray, x_m: float = 0.0, y_m: float = 0.0, turn_rad: float = 0.0, z_m: float = 0.0) -> FloatArray:
    """``T`` shifted in its outer frame, and turned on the spot."""
    turned = T @ pose_at(yaw=turn_rad)
    turned[:3, 3] += [x_m, y_m, z_m]
    return turned


# Agreement


@pytest.mark.parametrize("direction_rad", [0.0, 1.0, 2.0, 4.0])
def test_places_agree_up_to_the_limit_in_every_direction(direction_rad):
    c, s = np.cos(direction_rad), np.sin(direction_rad)
    for factor, expected in ((0.99, True), (1.01, False)):
        for sensor_range_m in (1.5, 30.0, 600.0):
            off_m = factor * AGREE_RANGES * sensor_range_m
            other = moved(T_BASE, off_m * c, off_m * s)
            assert poses_agree(T_BASE, other, sensor_range_m=sensor_range_m) is expected
            assert poses_agree(other, T_BASE, sensor_range_m=sensor_range_m) is expected


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_headings_agree_up_to_the_limit_also_across_half_a_turn(sign):
    for yaw_rad in (0.0, 2.5, np.pi - 0.01, -np.pi + 0.01):
        T = pose_at(3.0, 4.0, yaw=yaw_rad)
        assert poses_agree(T, moved(T, turn_rad=0.99 * sign * AGREE_RAD), sensor_range_m=RANGE_M)
        assert not poses_agree(T, moved(T, turn_rad=1.01 * sign * AGREE_RAD), sensor_range_m=RANGE_M)


def test_heights_are_not_compared():
    assert poses_agree(T_BASE, moved(T_BASE, z_m=10.0), sensor_range_m=RANGE_M)


# Odometry penalty


@pytest.mark.parametrize(
    ("x_m", "y_m", "turn_rad"), [(0.0, 0.0, 0.0), (1.5, 0.0, 0.0), (0.0, -2.0, 0.0), (0.0, 0.0, 0.06), (1, 2, -0.05)]
)
def test_the_penalty_near_the_prediction_is_half_the_squared_mahalanobis_distance(x_m, y_m, turn_rad):
    place_variance = SLIP_INFLATION**2 * (DRIFT[0] ** 2 + SIGMA_M**2)
    heading_variance = SLIP_INFLATION**2 * (DRIFT[1] ** 2 + CLOSURE_SIGMA_RAD**2)
    expected = 0.5 * ((x_m**2 + y_m**2) / place_variance + turn_rad**2 / heading_variance)
    measured = moved(T_BASE, x_m, y_m, turn_rad)
    assert odometry_penalty(T_BASE, measured, DRIFT, SIGMA_M) == pytest.approx(expected, rel=1e-6, abs=1e-12)


def test_across_a_break_it_does_not_matter_what_the_odometry_predicts():
    infinite = (np.inf, np.inf)
    penalties = {odometry_penalty(T_BASE, moved(T_BASE, x_m), infinite, SIGMA_M) for x_m in (0.0, 5.0, 500.0)}
    assert penalties == {0.0}


# Several candidates


def test_of_equal_places_the_best_is_kept_and_the_best_place_comes_first():
    weak = make_candidate(query=1, T_local_query=T_BASE, llrs={0: 11.0})
    strong = make_candidate(query=2, T_local_query=moved(T_BASE, 0.5), llrs={0: 30.0})
    penalized = make_candidate(query=3, T_local_query=moved(T_BASE, -0.5), llrs={0: 40.0}, odometry_penalty=15.0)
    elsewhere = make_candidate(query=4, T_local_query=moved(T_BASE, 30.0), llrs={0: 20.0})
    turned = make_candidate(query=5, T_local_query=moved(T_BASE, turn_rad=np.pi), llrs={0: 35.0})
    found = suppress_non_maxima([weak, elsewhere, penalized, strong, turned], sensor_range_m=RANGE_M)
    assert [candidate.query.id for candidate in found] == [5, 2, 4]
    assert suppress_non_maxima([], sensor_range_m=RANGE_M) == []
