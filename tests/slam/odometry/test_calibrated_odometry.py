"""Odometry with the faults corrected that a calibration names, against the path that it should have told."""

import numpy as np
import pytest

from logs.messages import Odometry
from slam.common.arrays import FloatArray
from slam.common.calibration import OdometryCalibration
from slam.common.geometry import invert, transform_from_xyz_yaw, yaw_rad
from slam.odometry.calibrated_odometry import CalibratedOdometry
from tests.helpers.poses import motion_by, pose_at

COUNT = 400


def chained(step_m: float, turns_rad: FloatArray) -> FloatArray:
    """Poses (K, 4, 4) after steps that go along the chord of their turns, from a pose of its own."""
    poses = [pose_at(3.0, -2.0, z=0.5, yaw=0.7)]
    for turn_rad in turns_rad:
        chord = transform_from_xyz_yaw(step_m * np.array([np.cos(turn_rad / 2), np.sin(turn_rad / 2), 0.0]), turn_rad)
        poses.append(poses[-1] @ chord)
    return np.array(poses)


def corrected(poses: FloatArray, **calibration: float) -> FloatArray:
    """Poses that follow each other every second."""
    scaled = CalibratedOdometry(OdometryCalibration(**calibration))
    return np.array([scaled.correct(Odometry(k * 10**9, T, "o", "b")).T_odom_body for k, T in enumerate(poses)])


def turns() -> FloatArray:
    return np.random.default_rng(0).uniform(-0.2, 0.25, COUNT)


@pytest.mark.parametrize(("length", "turn"), [(1.25, 1.0), (0.8, 0.9), (1.0, 1.2)])
def test_the_path_is_that_of_the_right_lengths_and_turns(length: float, turn: float):
    true = chained(0.5, turns())
    wrong = chained(0.5 / length, turns() / turn)
    np.testing.assert_allclose(corrected(wrong, length_scale=length, turn_scale=turn), true, atol=1e-6)


def test_each_step_climbs_by_a_share_of_its_length():
    poses = chained(0.5, turns())
    before = poses.copy()
    found = corrected(poses, climb=-0.1)
    np.testing.assert_allclose(found[:, 2, 3], 0.5 - 0.05 * np.arange(len(poses)), atol=1e-9)
    np.testing.assert_array_equal(poses, before)
    np.testing.assert_allclose(corrected(found, climb=0.1), poses, atol=1e-9)


@pytest.mark.parametrize("calibration", [{"drift_deg_per_s": 3.0}, {"curvature_deg_per_m": 6.0}])
def test_each_step_turns_by_its_time_and_length(calibration):
    found = corrected(chained(0.5, turns() - np.deg2rad(3.0)), **calibration)
    np.testing.assert_allclose(found, chained(0.5, turns()), atol=1e-6)


def test_turns_are_about_the_vertical_of_the_level_frame():
    T_odom_level = invert(OdometryCalibration(roll_deg=-90.0, pitch_deg=10.0).T_level_odom)
    found = corrected(T_odom_level @ chained(0.5, turns() / 1.3), roll_deg=-90.0, pitch_deg=10.0, turn_scale=1.3)
    np.testing.assert_allclose(found, T_odom_level @ chained(0.5, turns()), atol=1e-6)


def test_roll_and_pitch_stay():
    poses = chained(0.5, turns()) @ motion_by([0.2, -0.1, 0.0])
    found = corrected(poses, turn_scale=1.3)
    np.testing.assert_allclose(found[:, 2, :3], poses[:, 2, :3], atol=1e-12)
    assert abs(float(yaw_rad(invert(poses[-1]) @ found[-1]))) > 0.1


def test_a_repeated_pose_is_repeated_to_the_last_digit():
    poses = np.repeat(chained(0.5, turns()[:20]), 2, axis=0)
    found = corrected(poses, length_scale=1.1, turn_scale=0.9)
    assert found[::2].tobytes() == found[1::2].tobytes()


def test_stamps_and_lengths_are_corrected() -> None:
    calibrated = CalibratedOdometry(OdometryCalibration(length_scale=1.5, time_offset_s=0.25))
    poses = [pose_at(float(row)) for row in range(3)]
    found = [calibrated.correct(Odometry(row, T)) for row, T in enumerate(poses)]
    assert [(each.stamp_ns, each.T_odom_body[0, 3]) for each in found] == [
        (250_000_000, 0.0),
        (250_000_001, 1.5),
        (250_000_002, 3.0),
    ]
