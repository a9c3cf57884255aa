"""What motion is to be expected: the last velocity, and how far from it a robot usually is."""

from __future__ import annotations

import numpy as np
import pytest

from slam.common.geometry import transform_from_xyz_yaw
from slam.odometry.expected_motion import FLOOR_RAD, FLOOR_RANGES, LEAST_STEPS, ExpectedMotion

RANGE_M = 10.0


def arc(seconds: float) -> np.ndarray:
    """A circle of 10 m at 1 m/s."""
    angle = 0.1 * seconds
    return transform_from_xyz_yaw(np.array([10.0 * np.sin(angle), 10.0 - 10.0 * np.cos(angle), 0.0]), angle)


def on_arc(steps: int, jitter_m: float = 0.0) -> ExpectedMotion:
    motion = ExpectedMotion(RANGE_M)
    for step in range(steps):
        motion.add(step * 10**9, transform_from_xyz_yaw(np.array([jitter_m * (step % 2), 0.0, 0.0]), 0.0) @ arc(step))
    return motion


def test_a_body_on_a_circle_stays_on_it():
    np.testing.assert_allclose(on_arc(10).predict(10 * 10**9), arc(10.0), atol=1e-3)


def test_nothing_is_expected_of_a_body_that_was_seen_once():
    assert on_arc(1).predict(10**9) is None
    assert on_arc(1).is_usual(10**9, arc(500.0))


def test_what_is_usual_grows_with_the_changes_of_velocity_so_far():
    calm, shaken = on_arc(2 * LEAST_STEPS), on_arc(2 * LEAST_STEPS, jitter_m=0.2)
    stamp_ns = 2 * LEAST_STEPS * 10**9
    assert calm.tolerances(stamp_ns) == pytest.approx([FLOOR_RANGES * RANGE_M, FLOOR_RAD])
    assert shaken.tolerances(stamp_ns)[0] == pytest.approx(3 * 0.4, rel=0.05)
    off = arc(2.0 * LEAST_STEPS) @ transform_from_xyz_yaw(np.array([0.5, 0.0, 0.0]), 0.0)
    assert not calm.is_usual(stamp_ns, off)
    assert shaken.is_usual(stamp_ns, off)


def test_a_turn_is_judged_apart_from_a_shift():
    turned = arc(2.0 * LEAST_STEPS) @ transform_from_xyz_yaw(np.zeros(3), 0.2)
    assert not on_arc(2 * LEAST_STEPS, jitter_m=0.2).is_usual(2 * LEAST_STEPS * 10**9, turned)


def test_before_enough_steps_everything_is_usual():
    assert on_arc(LEAST_STEPS).is_usual(LEAST_STEPS * 10**9, arc(500.0))


def test_after_a_restart_the_velocity_is_not_known_but_what_is_usual_is():
    motion = on_arc(2 * LEAST_STEPS)
    stamp_ns = 2 * LEAST_STEPS * 10**9
    motion.restart(stamp_ns, arc(500.0))
    assert motion.predict(stamp_ns + 10**9) is None
    assert motion.tolerances(stamp_ns + 10**9) == pytest.approx([FLOOR_RANGES * RANGE_M, FLOOR_RAD])


def test_a_repeated_pose_is_usual_only_for_a_body_that_can_stop_at_once():
    stamp_ns = 2 * LEAST_STEPS * 10**9
    assert not on_arc(2 * LEAST_STEPS).is_usual(stamp_ns, arc(2.0 * LEAST_STEPS - 1.0))
    jerky = ExpectedMotion(RANGE_M)
    for step in range(2 * LEAST_STEPS):
        jerky.add(step * 10**9, transform_from_xyz_yaw(np.array([float(step // 2), 0.0, 0.0]), 0.0))
    assert jerky.is_usual(stamp_ns, transform_from_xyz_yaw(np.array([LEAST_STEPS - 1.0, 0.0, 0.0]), 0.0))


def test_corrections_change_the_velocity_by_as_much_as_they_are_certain():
    stamp_ns = 2 * LEAST_STEPS * 10**9
    faster = transform_from_xyz_yaw(np.array([2.0 * LEAST_STEPS + 1.0, 0.0, 0.0]), 0.0)
    speeds = []
    for sigma_m in (1e-3, 0.2, 100.0):
        motion = ExpectedMotion(RANGE_M)
        for step in range(2 * LEAST_STEPS):
            motion.add(step * 10**9, transform_from_xyz_yaw(np.array([step + 0.1 * (step % 2), 0.0, 0.0]), 0.0))
        before = float(motion.velocity[0])
        motion.correct(stamp_ns, faster, np.array([sigma_m**2, 1e-6]))
        speeds.append(float(motion.velocity[0]) - before)
        np.testing.assert_array_equal(motion.predict(stamp_ns), faster)
    assert speeds[0] > 2.0 * speeds[1] > 10.0 * speeds[2] > 0.0


def test_a_slow_body_that_repeats_its_pose_is_no_more_usual_than_a_fast_one():
    slow = ExpectedMotion(RANGE_M)
    for step in range(2 * LEAST_STEPS):
        slow.add(step * 10**9, transform_from_xyz_yaw(np.array([0.05 * step, 0.0, 0.0]), 0.0))
    last = transform_from_xyz_yaw(np.array([0.05 * (2 * LEAST_STEPS - 1), 0.0, 0.0]), 0.0)
    assert not slow.is_usual(2 * LEAST_STEPS * 10**9, last)
    assert slow.is_usual(2 * LEAST_STEPS * 10**9, last @ transform_from_xyz_yaw(np.array([0.01, 0.0, 0.0]), 0.0))
