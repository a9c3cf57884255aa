"""Scale of the noise of the odometry, from the corrections that landmarks make.

If the model is right, the corrections of the pose have the covariance by which they reduce that of its error
(covariance matching: Mehra, IEEE T-AC 1970). So the noise of translation, tilt and heading is scaled by the ratio of
the two over a window of scans, by its median: detections that err by far, and single slips, do not change it.
"""

from __future__ import annotations

import numpy as np
from scipy.special import chdtri

from slam.common.arrays import FloatArray

WINDOW = 20
"""Corrections after which the scale is estimated again."""
GATE = 11.34
"""Chi-squared with 3 degrees of freedom at 99 %: what is beyond contradicts its covariance."""
AXES = (slice(3, 6), slice(0, 2), slice(2, 3))
"""Translation, tilt and heading in a pose error, rotation first."""
DIMENSIONS = np.array([axes.stop - axes.start for axes in AXES])
MEDIAN = chdtri(DIMENSIONS, 0.5) / DIMENSIONS
"""Of the squares of normal errors by their variances."""


class NoiseScale:
    """``factors`` (3,) on the variances of the odometry's translation, tilt and heading, ``least`` where its model is
    right: a slip is larger than the noise of a step.
    """

    def __init__(self, least: float) -> None:
        self._least = least
        self.factors = np.full(3, least)
        self.innovation_ratio = 0.0
        """The last squared correction by its variance and the gate, the largest of the three."""
        self._ratios: list[FloatArray] = []

    def add(self, correction: FloatArray, reduction: FloatArray) -> None:
        """Add a correction (6,) of the pose and by how much (6, 6) it reduces the covariance of the error."""
        variances = np.diagonal(reduction)
        squares = np.array([float(correction[axes] @ correction[axes]) for axes in AXES])
        expected = np.array([float(variances[axes].sum()) for axes in AXES])
        ratios = squares / np.maximum(expected, 1e-300)
        self.innovation_ratio = float(np.max(ratios)) / GATE
        self._ratios.append(ratios)
        if len(self._ratios) < WINDOW:
            return
        ratios = np.median(self._ratios, axis=0) / MEDIAN
        ratios[1] = 1.0  # gravity holds the tilt, whatever heights seem to say
        gains = np.sqrt(np.clip(ratios, 1.0 / WINDOW, WINDOW))
        self.factors = np.maximum(self.factors * gains, self._least)
        self._ratios = []
