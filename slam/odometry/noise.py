"""Covariances of steps of the odometry."""

from __future__ import annotations

import numpy as np

from slam.common.arrays import FloatArray
from slam.common.config import OdometryConfig
from slam.common.geometry import rotation_angle_rad

# A break in the odometry ties nothing together, but the graph must stay connected until a closure does it.
BREAK_SIGMA_RAD = 1.0
BREAK_SIGMA_M = 100.0
# How many metres of travel a turn counts for in the noise of the heading.
METRES_PER_RADIAN = 10.0


def step_covariance(T_from_to: FloatArray, travel_m: float, config: OdometryConfig) -> FloatArray:
    """Covariance (6, 6) of a step of the odometry, rotation first, for its travel (at least its straight length)."""
    length_m = max(travel_m, float(np.linalg.norm(T_from_to[:3, 3])))
    # A turn is not free of error either, not even on the spot.
    turn_root = np.sqrt(length_m + METRES_PER_RADIAN * float(rotation_angle_rad(T_from_to)))
    tilt = max(config.min_rotation_sigma_rad, config.tilt_sigma * turn_root)
    yaw = max(config.min_rotation_sigma_rad, config.yaw_sigma * turn_root)
    translation = max(config.min_translation_sigma_m, config.translation_sigma * np.sqrt(length_m))
    return np.diag(np.array([tilt, tilt, yaw, translation, translation, translation]) ** 2)
