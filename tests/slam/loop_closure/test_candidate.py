"""Agreement of candidates, and the best of several."""

import numpy as np
import pytest

from slam.common.arrays import FloatArray
from slam.loop_closure.candidate import AGREE_RAD, AGREE_RANGES, suppress_non_maxima
from tests.helpers.candidates import make_candidate
from tests.helpers.poses import pose_at

RANGE_M = 30.0
T_BASE = pose_at(40.0, -7.0, z=1.0, yaw=2.5)


def moved(T: FloatArray, x_m: float = 0.0, y_m: float = 0.0, turn_rad: float = 0.0, z_m: float = 0.0) -> FloatArray:
    """``T`` shifted in its outer frame, and turned on the spot."""
    turned = T @ pose_at(yaw=turn_rad)
    turned[:3, 3] += [x_m, y_m, z_m]
    return turned


# Agreement


def agree(T_a: FloatArray, T_b: FloatArray, sensor_range_m: float = RANGE_M) -> bool:
    return make_candidate(T_local_query=T_a).agrees(T_b, sensor_range_m)


@pytest.mark.parametrize("direction_rad", [0.0, 1.0, 2.0, 4.0])
def test_places_agree_up_to_the_limit_in_every_direction(direction_rad):
    c, s = np.cos(direction_rad), np.sin(direction_rad)
    for factor, expected in ((0.99, True), (1.01, False)):
        for sensor_range_m in (1.5, 30.0, 600.0):
            off_m = factor * AGREE_RANGES * sensor_range_m
            other = moved(T_BASE, off_m * c, off_m * s)
            assert agree(T_BASE, other, sensor_range_m) is agree(other, T_BASE, sensor_range_m) is expected


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_headings_agree_up_to_the_limit_also_across_half_a_turn(sign):
    for yaw_rad in (0.0, 2.5, np.pi - 0.01, -np.pi + 0.01):
        T = pose_at(3.0, 4.0, yaw=yaw_rad)
        assert agree(T, moved(T, turn_rad=0.99 * sign * AGREE_RAD))
        assert not agree(T, moved(T, turn_rad=1.01 * sign * AGREE_RAD))


def test_heights_are_not_compared():
    assert agree(T_BASE, moved(T_BASE, z_m=10.0))


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
