"""How much larger the errors of the odometry are than its noise model says, by the corrections that landmarks make.

If the model is right, the corrections of the pose have the covariance by which they reduce that of its error
(covariance matching: Mehra, IEEE T-AC 1970). So the noise of translation, tilt and heading is scaled by the ratio of
the two over a window of scans.
"""

from __future__ import annotations

import numpy as np

from slam.common.arrays import FloatArray

WINDOW = 20
"""Corrections after which the scale is estimated anew."""
GATE = 11.34
"""Chi-squared with 3 degrees of freedom at 99 %: larger corrections contradict the odometry."""
SURE_SIGMAS = 6.0
"""A ratio that is so many standard deviations above 1 changes the scale before the window ends."""
AXES = (slice(3, 6), slice(0, 2), slice(2, 3))
"""Translation, tilt and heading in a pose error, rotation first."""


class NoiseScale:
    """``factors`` (3,) on the variances of the odometry's translation, tilt and heading, ``least`` where its model is
    right: a slip is larger than the noise of a step.
    """

    def __init__(self, least: float) -> None:
        self._least = least
        self.factors = np.full(3, least)
        self.innovation_ratio = 0.0
        """The last squared correction by its variance and the gate, the largest of the three."""
        self._squares, self._expected, self._count = np.zeros(3), np.zeros(3), 0

    def add(self, correction: FloatArray, reduction: FloatArray) -> None:
        """Add a correction (6,) of the pose and by how much (6, 6) it reduces the covariance of the error."""
        variances = np.diagonal(reduction)
        squares = np.array([float(correction[axes] @ correction[axes]) for axes in AXES])
        expected = np.array([float(variances[axes].sum()) for axes in AXES])
        self.innovation_ratio = float(np.max(squares / np.maximum(expected, 1e-300))) / GATE
        self._squares += squares
        self._expected += expected
        self._count += 1
        ratios = np.where(self._expected > 0.0, self._squares / np.maximum(self._expected, 1e-300), 1.0)
        ratios[1] = 1.0  # gravity holds the tilt, whatever heights seem to say
        excessive = ratios > 1.0 + SURE_SIGMAS * np.sqrt(2.0 / self._count)
        if self._count < WINDOW and not excessive.any():
            return
        gains = np.clip(ratios, 1.0 / WINDOW, WINDOW)
        if self._count < WINDOW:
            gains = np.where(excessive, gains, 1.0)
        self.factors = np.maximum(self.factors * np.where(excessive, gains, np.sqrt(gains)), self._least)
        self._squares, self._expected, self._count = np.zeros(3), np.zeros(3), 0
