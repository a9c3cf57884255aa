"""Keyframes: the poses of the odometry that the factor graph estimates."""

import math

import numpy as np

from logs.records import frozen
from slam.common.arrays import FloatArray
from slam.common.config import Config
from slam.common.geometry import relative, rotation_angle_rad
from slam.odometry.pose import OdometryPose

INTERVAL_S = 5.0
"""A body that moves at all has a keyframe so often, that a map is published while it creeps."""


@frozen
class Keyframe:
    """A pose of the track that the graph knows; ``T_local_body`` (4, 4): where landmarks around have it, see
    :mod:`slam.frontend.local_map`.

    ``is_prior``: a keyframe of a prior map. Its ``odometry`` holds its pose in that map, and no travel, time or speed.
    ``is_map_frame``: it is the frame of a map without keyframes, the reference anywhere in it.
    """

    id: int
    odometry: OdometryPose
    T_local_body: FloatArray
    is_prior: bool = False
    is_map_frame: bool = False


def is_keyframe_due(last: Keyframe, pose: OdometryPose, T_local_body: FloatArray, config: Config) -> bool:
    """Whether the body came so far since the last keyframe of its segment, or moved so long ago, that one is due.

    Wheels that turn while the body stands are motion, too: between keyframes the trajectory follows the odometry.

    Args:
        last: the last keyframe.
        pose: the pose now, by the odometry.
        T_local_body: (4, 4), where landmarks and odometry have the body now.
        config: with the distance from one keyframe to the next.
    """
    step = _motion(last.T_local_body, T_local_body)
    # By an eighteenth of a circle the view changes.
    if step[0] >= config.keyframe_distance_m or step[1] >= np.deg2rad(20.0):
        return True
    if pose.stamp_ns - last.odometry.stamp_ns < INTERVAL_S * 1e9:
        return False
    steps = step, _motion(last.odometry.T_odom_body, pose.T_odom_body)
    # With less motion the robot stands still.
    return any(moved_m >= 0.1 / 30.0 * config.sensor_range_m or turned_rad >= 0.02 for moved_m, turned_rad in steps)


def _motion(T_from: FloatArray, T_to: FloatArray) -> tuple[float, float]:
    """Length [m] and angle [rad] of the step from a pose (4, 4) to another."""
    T = relative(T_from, T_to)
    return math.hypot(*T[:3, 3]), float(rotation_angle_rad(T))
