"""Covariances of steps of the odometry: a random walk by travel, by turning and by time."""

import math

import numpy as np

from slam.common.arrays import FloatArray
from slam.common.calibration import OdometryCalibration
from slam.common.geometry import covariance_in_axes, relative, rotation_angle_rad
from slam.odometry.pose import OdometryPose

FREEDOM = 4.0
"""Degrees of freedom of Student's t-distribution of errors of the odometry, whose tails are heavy by slips."""
SLIP_INFLATION = 3.0
"""Factor on the sigmas of the odometry where a match is in question: slips are larger than the noise of a step."""


def step_variances(before: OdometryPose, after: OdometryPose, config: OdometryCalibration) -> FloatArray:
    """Variances (3,) of the step between two poses of one segment.

    They are those of each coordinate of the position [m^2], of roll and pitch [rad^2], and of the heading [rad^2], with
    what corrections in between add.
    """
    return model_variances(before, after, config) + np.abs(after.corrected - before.corrected)


def model_variances(before: OdometryPose, after: OdometryPose, config: OdometryCalibration) -> FloatArray:
    """The same without corrections."""
    straight_m = math.dist(before.T_odom_body[:3, 3], after.T_odom_body[:3, 3])
    length_m = max(abs(after.travel_m - before.travel_m), straight_m)
    turn_rad = float(rotation_angle_rad(relative(before.T_odom_body, after.T_odom_body)))
    seconds = abs(after.stamp_ns - before.stamp_ns) * 1e-9
    translation = max(config.min_translation_sigma_m**2, config.translation_sigma**2 * length_m)
    tilt = max(config.min_rotation_sigma_rad**2, config.tilt_sigma**2 * length_m)
    heading = max(
        config.min_rotation_sigma_rad**2, config.yaw_sigma**2 * length_m + config.yaw_sigma_by_turn**2 * turn_rad
    )
    return np.array(
        [
            translation + config.translation_sigma_by_time**2 * seconds,
            tilt,
            heading + config.yaw_sigma_by_time**2 * seconds,
        ]
    )


def step_covariance(
    before: OdometryPose, after: OdometryPose, config: OdometryCalibration, factors: FloatArray
) -> FloatArray:
    """Covariance (6, 6) of the step between two poses of one segment, with corrections; see :func:`covariance_of`.

    ``factors`` (2,): on the variances of the model, of translation and of heading.
    """
    of_translation, of_heading = factors
    corrected = np.abs(after.corrected - before.corrected)
    variances = np.array([of_translation, 1.0, of_heading]) * model_variances(before, after, config) + corrected
    return covariance_of(variances, after, of_translation * config.min_translation_sigma_m**2 + corrected[0])


def covariance_of(variances: FloatArray, after: OdometryPose, vertical: float) -> FloatArray:
    """Covariance (6, 6) of a step to a pose with ``variances`` (3,), rotation first, in the axes of the body there.

    The heading errs about the vertical, which is not the z axis of a body that leans. Slips and wrong lengths are along
    the ground: heights err by the tilt, and by ``vertical`` [m^2].
    """
    translation, tilt, heading = variances
    upright = np.diag([tilt, tilt, heading, translation, translation, vertical])
    return covariance_in_axes(upright, after.T_odom_body[:3, :3])
