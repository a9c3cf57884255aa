"""The trajectory between keyframes: it meets them, and keeps the odometry's shape in between."""

import numpy as np
import pytest

from slam.common.arrays import FloatArray
from slam.common.geometry import invert, transform_from_xyz_yaw
from slam.final_map import final_trajectory
from slam.odometry.keyframe import Keyframe
from slam.odometry.pose import OdometryPose
from slam.odometry.track import OdometryPath
from tests.helpers.poses import motion_by, pose_at
from tests.logs.examples import random_transform
from tests.slam.evaluation.drives import stamps, winding_path

COUNT = 41
NO_BREAKS = np.zeros(COUNT, int)


def odometry() -> FloatArray:
    return winding_path(COUNT)


def bend(keyframes: list[int], T_map_keyframe: FloatArray, segments=NO_BREAKS, T=None) -> FloatArray:
    path, T = OdometryPath(), odometry() if T is None else T
    poses = [OdometryPose(stamps(COUNT)[row], T[row], 0.0, segments[row], 0.0) for row in range(COUNT)]
    for pose in poses:
        path.add(pose)
    return final_trajectory(path, [Keyframe(k, poses[k], T[k]) for k in keyframes], T_map_keyframe, 0).T_map_body


@pytest.mark.parametrize("keyframes", [[0, 7, 20, 33], [0]])
def test_a_map_that_lies_elsewhere_moves_the_odometry_as_a_whole(keyframes):
    T_map_odom = random_transform(np.random.default_rng(0))
    np.testing.assert_allclose(bend(keyframes, T_map_odom @ odometry()[keyframes]), T_map_odom @ odometry(), atol=1e-9)


def test_it_meets_every_keyframe_without_a_step_at_either_side():
    rng = np.random.default_rng(1)
    keyframes = [0, 10, 20, 40]
    T_map_keyframe = odometry()[keyframes] @ motion_by(
        rng.normal(scale=0.05, size=(4, 3)), rng.normal(scale=0.5, size=(4, 3))
    )
    T = bend(keyframes, T_map_keyframe)
    np.testing.assert_allclose(T[keyframes], T_map_keyframe, atol=1e-9)
    change_of_step = np.linalg.norm(
        (invert(T[:-1]) @ T[1:] - invert(odometry()[:-1]) @ odometry()[1:])[:, :3, 3], axis=1
    )
    assert change_of_step.max() < 0.3


def test_poses_between_a_break_and_the_first_keyframe_after_it_follow_that_keyframe():
    keyframes, segments = [0, 10, 20], (np.arange(COUNT) >= 7).astype(np.int64)
    T_map_keyframe = odometry()[keyframes]
    T_map_keyframe[1:, 0, 3] += 100.0
    off_m = (bend(keyframes, T_map_keyframe, segments) - odometry())[:, 0, 3]
    np.testing.assert_allclose(off_m, 100.0 * segments, atol=1e-9)


def test_a_correction_is_shared_out_evenly_over_the_time_between_two_keyframes():
    line = transform_from_xyz_yaw(np.arange(COUNT)[:, None] * [1.0, 0, 0], np.zeros(COUNT))
    T_map_keyframe = line[[0, 40]].copy()
    T_map_keyframe[1, 1, 3] = 4.0
    T = bend([0, 40], T_map_keyframe, T=line)
    np.testing.assert_allclose(T[:, 1, 3], np.linspace(0.0, 4.0, COUNT), atol=1e-9)


def test_behind_the_last_keyframe_the_odometry_goes_on_from_it():
    T_map_keyframe = odometry()[[0, 20]].copy()
    T_map_keyframe[1] = T_map_keyframe[1] @ pose_at(1.0, 2.0, yaw=0.3)
    T = bend([0, 20], T_map_keyframe)
    np.testing.assert_allclose(invert(T[20]) @ T[40], invert(odometry()[20]) @ odometry()[40], atol=1e-9)


def test_nothing_is_blended_across_a_break():
    """The odometry starts anew at pose 15, which is a keyframe as every first pose behind a break."""
    keyframes = [0, 10, 15, 30]
    segments = np.where(np.arange(COUNT) < 15, 0, 1)
    T_odom = odometry()
    T_odom[15:] = pose_at(500.0, -300.0, yaw=2.0) @ T_odom[15:]
    T = bend(keyframes, odometry()[keyframes], segments, T_odom)
    np.testing.assert_allclose(T, odometry(), atol=1e-9)
