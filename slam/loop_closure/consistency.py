"""Consistency of loop-closure candidates with the odometry and with one another."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slam.common.arrays import FloatArray
from slam.common.calibration import ObjectCalibration
from slam.common.geometry import invert, yaw_rad
from slam.loop_closure.candidate import Candidate
from slam.odometry.noise import SLIP_INFLATION

# Two candidates agree if they put the query this near to each other: a wrong pose is mostly shifted by the spacing of
# the objects in a row, or more. In sensor ranges.
AGREE_RANGES = 1.0 / 15.0
AGREE_RAD = np.deg2rad(5.0)
TILT_SIGMA_RAD = np.deg2rad(1.0)
"""Error of gravity between two traversals."""
CLOSURE_SIGMA_RAD = np.deg2rad(0.8)
"""Heading error of a closure that its inliers share: what the centroids of a row of objects turn by."""


def poses_agree(T_a: FloatArray, T_b: FloatArray, *, sensor_range_m: float) -> bool:
    """Whether two estimates (4, 4) of one pose differ by less than ``AGREE_RANGES`` and ``AGREE_RAD``."""
    T_between = invert(T_a) @ T_b
    apart_m = np.hypot(T_between[0, 3], T_between[1, 3])
    return bool(apart_m < AGREE_RANGES * sensor_range_m and abs(yaw_rad(T_between)) < AGREE_RAD)


def suppress_non_maxima(candidates: Sequence[Candidate], *, sensor_range_m: float) -> list[Candidate]:
    """Of the candidates of one query that agree on its pose, the one with the highest score; by falling score."""
    kept: list[Candidate] = []
    for candidate in sorted(candidates, key=lambda c: -c.score):
        if not any(
            poses_agree(candidate.T_local_query, better.T_local_query, sensor_range_m=sensor_range_m) for better in kept
        ):
            kept.append(candidate)
    return kept


def shared_covariance(objects: ObjectCalibration) -> FloatArray:
    """Covariance (6, 6), rotation first, of the errors that all inliers of a registration share."""
    shift, height = objects.landmark_sigma_m, np.hypot(objects.landmark_sigma_m, objects.landmark_height_sigma_m)
    return np.diag(np.array([TILT_SIGMA_RAD, TILT_SIGMA_RAD, CLOSURE_SIGMA_RAD, shift, shift, height]) ** 2)


def odometry_penalty(
    T_predicted: FloatArray, T_measured: FloatArray, drift_sigmas: tuple[float, float], landmark_sigma_m: float
) -> float:
    """Negative log-likelihood of the odometry residual between two poses [nats].

    Half the squared Mahalanobis distance between prediction and measurement; zero across a discontinuity, where the
    odometry predicts nothing.

    Args:
        T_predicted: ``T_reference_query`` (4, 4) from the current estimate of the trajectory.
        T_measured: ``T_reference_query`` (4, 4) of the closure.
        drift_sigmas: standard deviations of the odometry between the two: position [m] and heading [rad]; infinite
            across a discontinuity.
        landmark_sigma_m: position error of a landmark between two traversals [m].
    """
    if np.isinf(drift_sigmas[0]):
        return 0.0
    sigma_m = SLIP_INFLATION * np.hypot(drift_sigmas[0], landmark_sigma_m)
    sigma_rad = SLIP_INFLATION * np.hypot(drift_sigmas[1], CLOSURE_SIGMA_RAD)
    off_m = float(np.hypot(*(T_measured[:2, 3] - T_predicted[:2, 3])))
    off_rad = abs(float(yaw_rad(invert(T_predicted) @ T_measured)))
    return 0.5 * float((off_m / sigma_m) ** 2 + (off_rad / sigma_rad) ** 2)
