"""Where landmarks are relative to the robot: one small Kalman filter each, in the odometry frame.

The odometry frame drifts as a whole but is smooth around the robot, so what the robot moved since it last saw a
landmark is all that blurs their relative position. That blur is the noise of the odometry over that travel; the
landmark's own filter is otherwise a static one. Nothing here depends on the optimised map, so a loop closure cannot
break the tracking.
"""

from __future__ import annotations

import numpy as np

from slam.common.arrays import FloatArray

_AXES = np.arange(3)


def predict_covariances(covariances: FloatArray, offsets: FloatArray, variances: FloatArray) -> FloatArray:
    """Covariances (N, 3, 3) m^2 of landmarks relative to the robot after it moved on.

    Args:
        covariances: (N, 3, 3) m^2 before.
        offsets: (N, 3) m, from the robot to each landmark, local frame.
        variances: (3,) of the step, as in :func:`slam.odometry.noise.step_variances`.

    A rotation error e of the robot moves a landmark at offset r by e x r, so a covariance Q of e becomes [r] Q [r]^T.
    """
    translation, tilt, heading = variances
    # Written out, it is -q r_i r_j beside the diagonal, with the q of the axis that is neither i nor j.
    of_third = np.array([[0.0, heading, tilt], [heading, 0.0, tilt], [tilt, tilt, 0.0]])
    added = -of_third * (offsets[:, :, None] * offsets[:, None, :])
    added[:, _AXES, _AXES] = translation + (offsets * offsets) @ of_third
    return np.asarray(covariances + added)


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
