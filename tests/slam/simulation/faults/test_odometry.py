"""Faults of the odometry: where they are and how large, as what happens to its steps."""

from collections.abc import Callable

import numpy as np
import pytest

from slam.common.arrays import FloatArray
from slam.common.calibration import OdometryCalibration
from slam.common.geometry import invert, rotation_angle_rad, transform_from_xyz_yaw, yaw_rad
from tests.slam.simulation.faults.streams import COUNT, drive, faulty

HALF, WHILE, ALL = 50, slice(50, 70), slice(None)


def turn(angle_rad: float | FloatArray) -> FloatArray:
    return transform_from_xyz_yaw(np.zeros((*np.shape(angle_rad), 3)), angle_rad)


def with_turns(before: FloatArray, factor: float) -> FloatArray:
    changed = before.copy()
    changed[:, :3, :3] = turn(factor * yaw_rad(before))[:, :3, :3]
    return changed


def with_lengths(before: FloatArray, factor: float) -> FloatArray:
    changed = before.copy()
    changed[:, :3, 3] *= factor
    return changed


STEPS: dict[str, tuple[slice, Callable[[FloatArray], FloatArray]]] = {
    "heading_jump=30:0.25": (slice(24, 25), lambda before: before @ turn(np.deg2rad(30.0))),
    "gyro_bias=3:2": (WHILE, lambda before: before @ turn(np.deg2rad(0.3))),
    "wheel_slip=1.5:2": (WHILE, lambda before: with_lengths(before, 1.5)),
    "odometry_freezes=2": (WHILE, lambda before: np.tile(np.eye(4), (len(before), 1, 1))),
    "odometry_scale=1.2": (ALL, lambda before: with_lengths(before, 1.2)),
    "odometry_turns=-1": (ALL, lambda before: with_turns(before, -1.0)),
}
"""Which steps a fault changes, and what they become."""


@pytest.mark.parametrize("fault", STEPS)
def test_fault_changes_these_steps(fault: str) -> None:
    rows, change = STEPS[fault]
    expected = drive().steps
    expected[rows] = change(expected[rows])
    np.testing.assert_allclose(faulty(fault).steps, expected, atol=1e-9)


def test_odometry_not_level_is_made_level_by_the_inverse() -> None:
    found = faulty("odometry_not_level=-90:10")
    level = OdometryCalibration(pitch_deg=-10.0).T_level_odom, OdometryCalibration(roll_deg=90.0).T_level_odom
    np.testing.assert_allclose(level[1] @ level[0] @ found.poses, drive().poses, atol=1e-9)


def test_pitch_jumps_once() -> None:
    errors = invert(drive().steps) @ faulty("pitch_jump=20").steps
    angles_rad = rotation_angle_rad(errors)
    assert np.flatnonzero(angles_rad > 1e-6).tolist() == [HALF - 1]
    assert angles_rad[HALF - 1] == pytest.approx(np.deg2rad(20.0))
    assert yaw_rad(errors[HALF - 1]) == pytest.approx(0.0)


def test_position_jumps_as_often_and_as_far_as_given() -> None:
    errors = invert(drive().steps) @ faulty("odometry_jumps=4:1.5").steps
    far_m = np.linalg.norm(errors[:, :3, 3], axis=1)
    assert far_m[far_m > 1e-6] == pytest.approx(np.full(4, 1.5))
    assert not errors[:, 2, 3].any()


def test_many_jumps_leave_rotations_as_they_are() -> None:
    R = faulty("odometry_jumps=90:1000").poses[:, :3, :3]
    np.testing.assert_allclose(R @ np.swapaxes(R, 1, 2), np.tile(np.eye(3), (COUNT, 1, 1)), atol=1e-9)


def test_one_message_is_wild() -> None:
    moved_m = np.linalg.norm(faulty("odometry_wild=1000").poses[:, :3, 3] - drive().poses[:, :3, 3], axis=1)
    assert np.flatnonzero(moved_m).tolist() == [HALF]
    assert moved_m[HALF] == pytest.approx(1000.0)


def test_odometry_restarts_at_the_origin() -> None:
    changed = faulty("odometry_restart").poses
    assert changed[HALF] == pytest.approx(np.eye(4))
    assert np.array_equal(changed[:HALF], drive().poses[:HALF])
    np.testing.assert_allclose(faulty("odometry_restart").steps[HALF:], drive().steps[HALF:], atol=1e-9)


@pytest.mark.parametrize("fault", ["odometry_translation_noise", "odometry_yaw_noise"])
def test_odometry_noise_grows_with_the_root_of_the_travel(fault: str) -> None:
    root_m = np.sqrt(np.linalg.norm(drive().steps[:, :3, 3], axis=1))
    found = []
    for seed in range(4):
        errors = invert(drive().steps) @ faulty(f"{fault}=0.02", seed=seed).steps
        size = yaw_rad(errors) if fault == "odometry_yaw_noise" else errors[:, 1, 3]
        found.append(size / root_m)
    assert np.std(found) == pytest.approx(0.02, rel=4.0 / np.sqrt(2.0 * 4 * (COUNT - 1)))
