"""Keyframes: the poses of the odometry that the factor graph estimates."""

from dataclasses import dataclass

import numpy as np

from slam.common.arrays import FloatArray
from slam.common.config import Config
from slam.common.geometry import relative, rotation_angle_rad
from slam.odometry.pose import OdometryPose

INTERVAL_S = 5.0
"""A body that moves at all has a keyframe so often, that a map is published while it creeps."""


@dataclass(frozen=True, slots=True, eq=False)
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
    T_steps = relative(
        np.array([last.T_local_body, last.odometry.T_odom_body]), np.array([T_local_body, pose.T_odom_body])
    )
    turns_rad, moved_m = rotation_angle_rad(T_steps), np.linalg.norm(T_steps[:, :3, 3], axis=1)
    # With less motion the robot stands still; by an eighteenth of a circle the view changes.
    has_moved = bool(np.any((moved_m >= 0.1 / 30.0 * config.sensor_range_m) | (turns_rad >= 0.02)))
    has_turned = turns_rad[0] >= np.deg2rad(20.0)
    is_late = pose.stamp_ns - last.odometry.stamp_ns >= INTERVAL_S * 1e9
    return bool(moved_m[0] >= config.keyframe_distance_m or has_turned or (is_late and has_moved))
