"""Which closures agree, what the odometry says against one, and how much two say together."""

from __future__ import annotations

import numpy as np
import pytest

from slam.common.arrays import FloatArray
from slam.common.config import LoopClosureConfig
from slam.common.geometry import transform_from_xyz_yaw
from slam.loop_closure.consistency import AGREE_M, AGREE_RAD, agree, distinct, doubt_nats, joint_score_nats
from tests.helpers.candidates import make_candidate

CONFIG = LoopClosureConfig()
DRIFT = (0.8, 0.02)
T_BASE = transform_from_xyz_yaw(np.array([40.0, -7.0, 1.0]), 2.5)


def moved(T: FloatArray, x_m: float = 0.0, y_m: float = 0.0, turn_rad: float = 0.0, z_m: float = 0.0) -> FloatArray:
    """``T`` shifted in its outer frame, and turned on the spot."""
    turned = T @ transform_from_xyz_yaw(np.zeros(3), turn_rad)
    turned[:3, 3] += [x_m, y_m, z_m]
    return turned


# Agreement


@pytest.mark.parametrize("direction_rad", [0.0, 1.0, 2.0, 4.0])
def test_places_agree_up_to_the_limit_in_every_direction(direction_rad):
    c, s = np.cos(direction_rad), np.sin(direction_rad)
    for factor, expected in ((0.99, True), (1.01, False)):
        other = moved(T_BASE, factor * AGREE_M * c, factor * AGREE_M * s)
        assert agree(T_BASE, other) is expected
        assert agree(other, T_BASE) is expected


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_headings_agree_up_to_the_limit_also_across_half_a_turn(sign):
    for yaw_rad in (0.0, 2.5, np.pi - 0.01, -np.pi + 0.01):
        T = transform_from_xyz_yaw(np.array([3.0, 4.0, 0.0]), yaw_rad)
        assert agree(T, moved(T, turn_rad=0.99 * sign * AGREE_RAD))
        assert not agree(T, moved(T, turn_rad=1.01 * sign * AGREE_RAD))


def test_heights_are_not_compared():
    assert agree(T_BASE, moved(T_BASE, z_m=10.0))


# Doubt


def test_the_odometry_does_not_doubt_what_it_predicts():
    assert doubt_nats(T_BASE, T_BASE, DRIFT, CONFIG) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(
    ("x_m", "y_m", "turn_rad"), [(1.5, 0.0, 0.0), (0.0, -2.0, 0.0), (0.0, 0.0, 0.06), (1, 2, -0.05)]
)
def test_doubt_near_the_prediction_is_half_the_squared_mahalanobis_distance(x_m, y_m, turn_rad):
    place_variance = CONFIG.odometry_inflation**2 * (DRIFT[0] ** 2 + CONFIG.base_sigma_m**2)
    heading_variance = CONFIG.odometry_inflation**2 * (DRIFT[1] ** 2 + np.deg2rad(CONFIG.base_sigma_deg) ** 2)
    expected = 0.5 * ((x_m**2 + y_m**2) / place_variance + turn_rad**2 / heading_variance)
    assert 0.0 < expected < CONFIG.max_doubt_nats
    measured = moved(T_BASE, x_m, y_m, turn_rad)
    assert doubt_nats(T_BASE, measured, DRIFT, CONFIG) == pytest.approx(expected, rel=1e-6)


def test_doubt_is_bounded_and_never_falls_with_the_distance():
    doubts = [doubt_nats(T_BASE, moved(T_BASE, x_m), DRIFT, CONFIG) for x_m in np.linspace(0.0, 500.0, 60)]
    assert np.all(np.diff(doubts) >= 0.0)
    assert doubts[-1] == CONFIG.max_doubt_nats
    assert doubt_nats(T_BASE, moved(T_BASE, turn_rad=np.pi), DRIFT, CONFIG) == CONFIG.max_doubt_nats


def test_more_drift_means_less_doubt():
    measured = moved(T_BASE, 3.0, 1.0, 0.05)
    doubts = [doubt_nats(T_BASE, measured, (k * 0.5, k * 0.01), CONFIG) for k in (1.0, 2.0, 4.0)]
    assert np.all(np.diff(doubts) < 0.0)


def test_across_a_break_it_does_not_matter_what_the_odometry_predicts():
    infinite = (np.inf, np.inf)
    doubts = {doubt_nats(T_BASE, moved(T_BASE, x_m), infinite, CONFIG) for x_m in (0.0, 5.0, 500.0)}
    assert len(doubts) == 1
    assert 0.0 <= doubts.pop() < CONFIG.max_doubt_nats


# Several candidates


def test_of_equal_places_the_best_is_kept_and_the_best_place_comes_first():
    weak = make_candidate(query=1, T_odom_query=T_BASE, nats={0: 11.0})
    strong = make_candidate(query=2, T_odom_query=moved(T_BASE, 0.5), nats={0: 30.0})
    doubted = make_candidate(query=3, T_odom_query=moved(T_BASE, -0.5), nats={0: 40.0}, doubt_nats=15.0)
    elsewhere = make_candidate(query=4, T_odom_query=moved(T_BASE, 30.0), nats={0: 20.0})
    turned = make_candidate(query=5, T_odom_query=moved(T_BASE, turn_rad=np.pi), nats={0: 35.0})
    found = distinct([weak, elsewhere, doubted, strong, turned])
    assert [candidate.query for candidate in found] == [5, 2, 4]
    assert distinct([]) == []


def test_an_object_that_several_weigh_counts_once_by_its_mean():
    a = make_candidate(nats={1: 4.0, 2: 6.0, 3: -1.0})
    b = make_candidate(nats={2: 2.0, 3: 3.0, 9: 5.0})
    c = make_candidate(nats={3: 7.0, 9: 1.0, 4: 0.5})
    two = 4.0 + (6.0 + 2.0) / 2 + (-1.0 + 3.0) / 2 + 5.0
    assert joint_score_nats([a, b]) == pytest.approx(two)
    assert joint_score_nats([b, a]) == pytest.approx(two)
    three = 4.0 + (6.0 + 2.0) / 2 + (-1.0 + 3.0 + 7.0) / 3 + (5.0 + 1.0) / 2 + 0.5
    assert joint_score_nats([c, a, b]) == pytest.approx(three)


def test_candidates_with_the_same_objects_say_no_more_than_one():
    a = make_candidate(nats={1: 8.0, 2: 6.0}, doubt_nats=2.0)
    assert joint_score_nats([a]) == pytest.approx(a.score_nats)
    assert joint_score_nats([a, a, a]) == pytest.approx(a.score_nats)


def test_candidates_without_a_common_object_say_as_much_as_all_less_the_greatest_doubt():
    a = make_candidate(nats={1: 8.0, 2: 6.0}, doubt_nats=3.0)
    b = make_candidate(nats={5: 9.0}, doubt_nats=1.0)
    assert joint_score_nats([a, b]) == pytest.approx(8.0 + 6.0 + 9.0 - 3.0)
