"""Covariances of steps of the odometry: a random walk by travel, by turning and by time."""

from __future__ import annotations

import math

import numpy as np

from slam.common.arrays import FloatArray
from slam.common.calibration import OdometryCalibration
from slam.common.geometry import covariance_in_axes, relative, rotation_angle_rad
from slam.odometry.pose import OdometryPose

# A break in the odometry ties nothing together, but the graph must stay connected until a closure does it.
BREAK_SIGMA_RAD = 1.0
BREAK_SIGMA_RANGES = 100 / 30
SLIP_INFLATION = 3.0
"""Factor on the sigmas of the odometry where a match is in question: slips are larger than the noise of a step."""


def step_variances(before: OdometryPose, after: OdometryPose, config: OdometryCalibration) -> FloatArray:
    """Variances (3,) of the step between two poses of one segment.

    They are those of each coordinate of the position [m^2], of roll and pitch [rad^2], and of the heading [rad^2], with
    those of a mended step in between.
    """
    T_before_after = relative(before.T_odom_body, after.T_odom_body)
    length_m = max(abs(after.travel_m - before.travel_m), math.hypot(*T_before_after[:3, 3].tolist()))
    turn_rad = float(rotation_angle_rad(T_before_after))
    seconds = abs(after.stamp_ns - before.stamp_ns) * 1e-9
    mended_m2, mended_rad2 = abs(after.mended_m2 - before.mended_m2), abs(after.mended_rad2 - before.mended_rad2)
    translation = max(config.min_translation_sigma_m**2, config.translation_sigma**2 * length_m)
    tilt = max(config.min_rotation_sigma_rad**2, config.tilt_sigma**2 * length_m)
    heading = max(
        config.min_rotation_sigma_rad**2, config.yaw_sigma**2 * length_m + config.yaw_sigma_by_turn**2 * turn_rad
    )
    return np.array(
        [
            translation + config.translation_sigma_by_time**2 * seconds + mended_m2,
            tilt + mended_rad2,
            heading + config.yaw_sigma_by_time**2 * seconds + mended_rad2,
        ]
    )


def step_covariance(
    before: OdometryPose, after: OdometryPose, config: OdometryCalibration, *, heading_factor: float = 1.0
) -> FloatArray:
    """Covariance (6, 6) of the step between two poses of one segment, rotation first, in the axes of the body after it.

    The heading errs about the vertical, which is not the z axis of a body that leans. Slips and wrong lengths are along
    the ground: heights err by the tilt. ``heading_factor``: on the variance of the heading.
    """
    translation, tilt, yaw = step_variances(before, after, config)
    vertical = config.min_translation_sigma_m**2 + abs(after.mended_m2 - before.mended_m2)
    upright = np.diag([tilt, tilt, heading_factor * yaw, translation, translation, vertical])
    return covariance_in_axes(upright, after.T_odom_body[:3, :3])
