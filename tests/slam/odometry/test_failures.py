"""Where the heading of the odometry fails, by what landmarks say of its steps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam.common.calibration import OdometryCalibration
from slam.common.geometry import transform_from_xyz_yaw
from slam.odometry.failures import find_heading_failures
from slam.odometry.keyframe import Keyframe
from slam.odometry.pose import OdometryPose

CONFIG = OdometryCalibration(yaw_sigma=0.002, yaw_sigma_by_turn=0.0)
FAILURES_PER_KM = 1e-3
STEPS = 60
FAILING = slice(20, 40)


def keyframes(turns: np.ndarray, corrections: np.ndarray) -> list[Keyframe]:
    """Keyframes 1 m apart whose odometry turns by ``turns`` (K,) rad more than landmarks, which tell of jitter
    ``corrections`` (K + 1,) rad in the headings.
    """
    headings = np.concatenate([[0.0], np.cumsum(turns)])
    found = []
    for number, (heading, jitter) in enumerate(zip(headings.tolist(), corrections.tolist(), strict=True)):
        T_odom_body = transform_from_xyz_yaw(np.array([number, 0.0, 0.0]), heading)
        pose = OdometryPose(number * 10**9, T_odom_body, float(number), 0, 1.0)
        found.append(Keyframe(number, pose, transform_from_xyz_yaw(np.array([number, 0.0, 0.0]), jitter)))
    return found


def drive(*, bias: float = 0.0, jitter: float = 0.0) -> list[Keyframe]:
    rng = np.random.default_rng(1)
    turns = rng.normal(0.0, 0.002, STEPS)
    turns[FAILING] += bias
    return keyframes(turns, rng.normal(0.0, jitter, STEPS + 1))


def find(found: list[Keyframe]) -> dict[int, float]:
    return find_heading_failures(found, CONFIG, failures_per_km=FAILURES_PER_KM)


def test_an_odometry_as_good_as_its_noise_does_not_fail() -> None:
    assert find(drive()) == {}
    assert find(drive()[:3]) == {}


def test_corrections_that_scatter_are_no_failures() -> None:
    assert find(drive(jitter=0.05)) == {}


def test_a_bias_within_the_noise_of_each_step_is_found() -> None:
    found = find(drive(bias=0.01))
    # The keyframe after the first step is number 1.
    assert set(range(FAILING.start + 1, FAILING.stop + 1)) <= set(found)
    assert 1 not in found
    assert STEPS not in found


def test_the_factor_makes_the_sum_of_a_window_one_standard_deviation() -> None:
    turns = np.zeros(8)
    turns[2:6] = 0.1
    found = find(keyframes(turns, np.zeros(9)))
    # All four steps: (4 * 0.1)^2 / (4 * 0.002^2).
    assert found[4] == pytest.approx(0.4**2 / (4 * 0.002**2), rel=1e-6)


def test_what_is_judged_by_inflated_noise() -> None:
    """Of 4 m, 4e-6 failures are expected: 2 ln 250000 = 24.9, times the square of the inflation."""
    turns = np.zeros(4)
    for excess, fails in ((9 * 24.8, False), (9 * 25.0, True)):
        turns[:] = np.sqrt(excess * 4 * 0.002**2) / 4
        assert bool(find(keyframes(turns, np.zeros(5)))) is fails


def test_nothing_is_said_of_prior_keyframes_or_across_breaks() -> None:
    members = drive(bias=0.01)
    assert find([replace(each, is_prior=True) for each in members]) == {}
    broken = [
        replace(each, odometry=replace(each.odometry, segment=each.id // 4)) if 15 < each.id < 45 else each
        for each in members
    ]
    assert find(broken) == {}
