"""Where landmarks are relative to the robot: one small Kalman filter each, in the odometry frame.

The odometry frame drifts as a whole but is smooth around the robot, so what the robot moved since it last saw a
landmark is all that blurs their relative position. That blur is the noise of the odometry over that travel; the
landmark's own filter is otherwise a static one. Nothing here depends on the optimised map, so a loop closure cannot
break the tracking.
"""

from __future__ import annotations

import numpy as np

from slam.common.arrays import FloatArray
from slam.common.config import OdometryConfig


def predict_covariances(
    covariances: FloatArray, offsets: FloatArray, travel_since_m: FloatArray, config: OdometryConfig
) -> FloatArray:
    """Covariances (N, 3, 3) m^2 of landmarks relative to the robot after it moved on.

    Args:
        covariances: (N, 3, 3) m^2 when each was last seen.
        offsets: (N, 3) m, from the robot to each landmark, odometry frame.
        travel_since_m: (N,) travel since then.
        config: noise of the odometry.

    A rotation error e of the robot moves a landmark at offset r by e x r, so a covariance Q of e becomes [r] Q [r]^T.
    """
    translation_variance = config.translation_sigma**2 * travel_since_m
    rotation_variances = np.array([config.tilt_sigma, config.tilt_sigma, config.yaw_sigma]) ** 2
    cross = np.zeros_like(covariances)
    for axis, (first, second) in enumerate(((1, 2), (2, 0), (0, 1))):
        cross[:, second, first] = offsets[:, axis]
        cross[:, first, second] = -offsets[:, axis]
    turned = (cross * rotation_variances) @ np.swapaxes(cross, -1, -2) * travel_since_m[:, None, None]
    return np.asarray(covariances + translation_variance[:, None, None] * np.eye(3) + turned)


def update_positions(
    positions: FloatArray, covariances: FloatArray, measured: FloatArray, measured_covariances: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Fuse positions (N, 3) m with measurements of them, covariances (N, 3, 3) m^2; returns both after the update.

    The Kalman update for a position measured directly, in the symmetric form P R (P + R)^-1.
    """
    S = covariances + measured_covariances
    gain = np.swapaxes(np.linalg.solve(S, covariances), -1, -2)
    fused = positions + np.einsum("nij,nj->ni", gain, measured - positions)
    fused_covariances = gain @ measured_covariances
    return fused, 0.5 * (fused_covariances + np.swapaxes(fused_covariances, -1, -2))
