"""Whether a scan continues the local map: how the odometry goes on at a step that was not to be expected.

For each way to go on, the detections of the next scan are associated with the active landmarks as predicted from the
pose that it gives. The log-likelihood ratio against a place where nothing is known sums over the detections

    log(P N(z; z_predicted, S) p(label) / density)   where one has a landmark,   log(1 - P)   where it has none,

with P the probability that what is seen is known, and the density of the landmarks around.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from slam.common.arrays import FloatArray, IntArray
from slam.common.calibration import ObjectCalibration
from slam.frontend.active_landmarks import Prediction
from slam.frontend.data_association import associate
from slam.odometry.unexpected_step import Continuation, UnexpectedStep

KNOWN_PROBABILITY = 0.5
"""Probability that a detection is of an active landmark, where the robot has been seeing them."""
DECIDED = 0.99
"""Probability from which a way to go on is believed against another."""


def scan_log_likelihood_ratio(
    positions: FloatArray,
    covariances: FloatArray,
    labels: IntArray,
    predicted: Prediction,
    beliefs: FloatArray,
    config: ObjectCalibration,
) -> float:
    """Log-likelihood ratio of a scan between a predicted pose and a place where nothing is known.

    Args:
        positions: (D, 3) m, detections, in the frame of the prediction.
        covariances: (D, 3, 3) m^2, of the detections.
        labels: (D,) index of each detection's label.
        predicted: of the A active landmarks.
        beliefs: (A, C) class probabilities of the landmarks.
        config: gate and label model; the density of the landmarks stands for that of new objects.
    """
    if len(positions) == 0 or len(predicted.positions) == 0:
        return 0.0
    crowded = in_a_crowd(config, predicted, covariances)
    assignment = associate(positions, covariances, labels, predicted.positions, predicted.covariances, beliefs, crowded)
    matched = int(assignment.matched.sum())
    unmatched = len(positions) - matched
    known = matched * np.log(KNOWN_PROBABILITY) + unmatched * np.log1p(-KNOWN_PROBABILITY)
    return float(assignment.log_likelihood_ratio + known)


def in_a_crowd(config: ObjectCalibration, predicted: Prediction, covariances: FloatArray) -> ObjectCalibration:
    """The configuration with the density of the landmarks around for that of new objects."""
    if len(predicted.positions) == 0:
        return config
    return config.model_copy(update={"new_object_density": _density(predicted, covariances)})


def decide(step: UnexpectedStep, log_likelihood_ratios: Mapping[Continuation, float]) -> Continuation | None:
    """How the track goes on; ``step.default`` where the detections do not tell, None where the next ones will.

    An odometry that repeats one pose to the last digit may be right or frozen, which shows the farther the body should
    be by now. Once it was found to be frozen, it is until the detections show that the body has stopped.
    """
    margin = float(np.log(DECIDED / (1.0 - DECIDED)))
    reported = log_likelihood_ratios[Continuation.REPORTED]
    expected = log_likelihood_ratios.get(Continuation.EXPECTED, -np.inf)
    if expected > max(reported, 0.0) + margin:
        return Continuation.EXPECTED
    if step.is_frozen and step.goes_on_frozen and expected > max(reported, 0.0) - margin:
        return Continuation.EXPECTED
    if step.is_frozen and not step.goes_on_frozen and abs(expected - reported) <= margin:
        return None
    return Continuation.REPORTED if reported > margin else step.default


def _density(predicted: Prediction, covariances: FloatArray) -> float:
    """Landmarks per m^3 in the cylinder around the robot that holds them."""
    positions = predicted.positions
    radius_m = float(np.max(np.linalg.norm(positions[:, :2] - np.median(positions[:, :2], axis=0), axis=1)))
    sigma_m = float(np.sqrt(np.median(covariances[:, 2, 2]) + np.median(predicted.covariances[:, 2, 2])))
    sigma_xy_m = float(np.sqrt(np.median(covariances[:, 0, 0]) + np.median(predicted.covariances[:, 0, 0])))
    # What stands at one height is spread by the noise alone: sqrt(2 pi e) sigmas, the entropy of a Gaussian.
    spread = float(np.sqrt(2.0 * np.pi * np.e))
    height_m = max(float(np.ptp(positions[:, 2])), spread * sigma_m)
    return len(positions) / (np.pi * max(radius_m, spread * sigma_xy_m) ** 2 * height_m)
