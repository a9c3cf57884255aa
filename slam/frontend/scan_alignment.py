"""Where the robot is by one scan, where the odometry tells little: the scan aligned with the landmarks around.

The pose has a wide Gaussian prior with covariance Q. Detections z at the offsets o from the robot are associated with
landmarks m, and a correction d = (x, y, heading) of the pose that minimises

    d^T Q^-1 d + sum (m - z - A d)^T S^-1 (m - z - A d),    A = [I  J o],  J = [0 -1; 1 0]

is found by Gauss-Newton, with new associations each time. With C the covariance of d, the log-likelihood ratio of the
scan against a place where nothing is known is by Laplace's approximation that at the corrected pose
- d^T Q^-1 d / 2 + log(|C| / |Q|) / 2 (MacKay, Information Theory, Inference, and Learning Algorithms, 2003, ch. 27).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from slam.common.arrays import FloatArray, IntArray
from slam.common.calibration import ObjectCalibration
from slam.common.geometry import apply, make_transform, transform_from_xyz_yaw
from slam.frontend.active_landmarks import Prediction
from slam.frontend.continuity import in_a_crowd, scan_log_likelihood_ratio
from slam.frontend.data_association import associate
from slam.frontend.landmark_filter import predict_covariances

ROUNDS = 4
"""Associations and corrections in turn; the first ones are made at the greatest uncertainty."""


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """``T_correction`` (4, 4) moves the pose, in the frame that it is in; ``variances`` (2,) of what is left, of each
    horizontal coordinate [m^2] and of the heading [rad^2]; ``log_likelihood_ratio`` against a place where nothing is
    known.
    """

    T_correction: FloatArray
    variances: FloatArray
    log_likelihood_ratio: float


def align_scan(
    positions: FloatArray,
    covariances: FloatArray,
    labels: IntArray,
    predicted: Prediction,
    beliefs: FloatArray,
    config: ObjectCalibration,
    *,
    origin: FloatArray,
    sigmas: FloatArray,
) -> Alignment:
    """Align a scan with the landmarks around.

    Args:
        positions: (D, 3) m, detections as seen from the expected pose, in the frame of the prediction.
        covariances: (D, 3, 3) m^2, of the detections.
        labels: (D,) index of each detection's label.
        predicted: of the A active landmarks, relative to the robot.
        beliefs: (A, C) class probabilities of the landmarks.
        config: gate and label model.
        origin: (3,) m, the expected position of the robot.
        sigmas: (2,) m and rad, how far off the expected pose may be.
    """
    prior = np.array([sigmas[0], sigmas[0], sigmas[1]]) ** 2
    covariance = np.diag(prior)
    change = np.zeros(3)
    crowded = in_a_crowd(config, predicted, covariances)
    for _ in range(ROUNDS):
        moved = apply(_motion(change, origin), positions)
        at = origin + np.array([change[0], change[1], 0.0])
        variances = np.array([max(covariance[0, 0], covariance[1, 1]), 0.0, covariance[2, 2]])
        widened = predict_covariances(predicted.covariances, predicted.positions - at, variances)
        found = associate(moved, covariances, labels, predicted.positions, widened, beliefs, crowded)
        seen, met = found.matched, found.landmark_rows[found.matched]
        S = (predicted.covariances[met] + covariances[seen])[:, :2, :2]
        offsets = moved[seen, :2] - at[:2]
        A = np.zeros((len(met), 2, 3))
        A[:, 0, 0] = A[:, 1, 1] = 1.0
        A[:, 0, 2], A[:, 1, 2] = -offsets[:, 1], offsets[:, 0]
        weighted = np.linalg.solve(S, A)
        innovation = predicted.positions[met, :2] - moved[seen, :2]
        covariance = np.linalg.inv(np.diag(1.0 / prior) + np.einsum("nij,nik->jk", A, weighted))
        change = change + covariance @ (np.einsum("nij,ni->j", weighted, innovation) - change / prior)
    T_correction = _motion(change, origin)
    # Where nothing could be associated, the scan is judged at the uncertainty that the pose has.
    judged = predicted if len(met) else replace(predicted, covariances=widened)
    ratio = scan_log_likelihood_ratio(apply(T_correction, positions), covariances, labels, judged, beliefs, config)
    occam = 0.5 * (np.linalg.slogdet(covariance)[1] - np.log(prior).sum())
    return Alignment(
        T_correction,
        np.array([max(covariance[0, 0], covariance[1, 1]), covariance[2, 2]]),
        float(ratio - 0.5 * np.sum(change**2 / prior) + occam),
    )


def _motion(change: FloatArray, origin: FloatArray) -> FloatArray:
    """The transform (4, 4) that turns about ``origin`` and moves by ``change`` (x, y, heading)."""
    T = transform_from_xyz_yaw(np.zeros(3), float(change[2]))
    return make_transform(T[:3, :3], origin + np.array([change[0], change[1], 0.0]) - T[:3, :3] @ origin)
