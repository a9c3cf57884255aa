"""Scale of the noise of the odometry, from the innovations of the landmarks that correct it.

The innovations y of a scan, whitened by their covariance S, are W n for an error n of the step before it, whose
coordinates have the variance of the model times a factor. The factor is the fixed point of

    factor <- factor * (|W' y|^2 / |W|^2),

with the columns of W for translation or heading, scaled by their standard deviations: the maximum likelihood
(Zhou et al., MM algorithms for variance components models, JCGS 2019). It takes one landmark, and tells what that one
can tell. The ratio is the weighted median over a window of scans, so that detections that err by far, and single
slips, do not change it. Gravity and the ground hold tilt and height, whatever heights of detections seem to say.

A slip is a step whose error n contradicts even SLIP_INFLATION times the calibrated noise, also where the factor has
grown to expect it, and explains the innovations of at least three landmarks. The estimate of n is its posterior mean
W' y.
"""

import numpy as np
from scipy.special import chdtrc, chdtri

from slam.common.arrays import FloatArray
from slam.odometry.noise import SLIP_INFLATION

WINDOW = 20
"""Corrections after which the scale is estimated again."""
GATE = 11.34
"""Chi-squared with 3 degrees of freedom at 99 %: what is beyond contradicts its covariance."""


class NoiseScale:
    """``factors`` (2,) on the variances of the odometry's translation and heading, 1 where its model is right; at
    ``most`` (2,) where it tells nothing.
    """

    def __init__(self, most: FloatArray) -> None:
        self._most = np.maximum(most, 1.0)
        self.factors = np.ones(2)
        self.innovation_ratio = 0.0
        """The last squared correction by its variance and the gate, the larger of the two."""
        self._window: list[FloatArray] = []  # (2, 2) each: ratios of translation and heading, and their weights

    def slip(self, innovation: FloatArray, effects: FloatArray, *, has_slipped: bool = False) -> FloatArray:
        """The error (3,) of the last step if it slipped, else zeros; in standard deviations, by which ``effects`` are
        scaled. Arguments as of ``add``; ``has_slipped``: the standard deviations are those of a slip already.
        """
        none = np.zeros(3)
        # Earlier steps had other lever arms, so that effects may be larger than the innovations allow, which is 1.
        error = effects.T @ innovation / max(float(np.linalg.eigvalsh(effects.T @ effects)[-1]), 1.0)
        heading, x, y = error
        ratios = self.factors * [(x**2 + y**2) / 3.0, heading**2]
        if np.max(ratios) < GATE * (1.0 if has_slipped else SLIP_INFLATION**2):
            return none
        rest = innovation - effects @ np.linalg.lstsq(effects, innovation)[0]
        # One or two landmarks leave no degrees of freedom of a pose in space, and chdtrc is then 0 or NaN.
        return error if chdtrc(len(innovation) - 6, rest @ rest) > 0.01 else none

    def add(self, innovation: FloatArray, effects: FloatArray) -> None:
        """Add whitened innovations (M,), and the effects (M, 3) on them of an error of one standard deviation in the
        heading, x and y of the step before.
        """
        sums = [
            (np.sum((part.T @ innovation) ** 2), np.sum(part**2), np.sum((part.T @ part) ** 2))
            for part in (effects[:, 1:3], effects[:, :1])  # translation and heading
        ]
        squares, expected, joint = np.transpose(sums)
        # Sums of squares that count like so many independent ones (Satterthwaite, 1946).
        dimensions = np.maximum(expected**2 / np.maximum(joint, 1e-300), 1.0)
        ratios = np.divide(squares, expected, out=np.ones(2), where=expected > 0.0)
        self.innovation_ratio = float(np.max(ratios)) / GATE
        self._window.append(np.array([ratios * dimensions / chdtri(dimensions, 0.5), expected]))
        if len(self._window) < WINDOW:
            return
        ratios = np.array([_weighted_median(*each) for each in np.transpose(self._window)])
        gains = np.sqrt(np.clip(ratios, 1.0 / WINDOW, WINDOW))
        self.factors = np.clip(self.factors * gains, 1.0, self._most)
        self._window = []


def _weighted_median(values: FloatArray, weights: FloatArray) -> float:
    """Weighted median of values (N,); 1 without weights."""
    order = np.argsort(values, kind="stable")
    total = np.cumsum(weights[order])
    return float(values[order[np.searchsorted(total, 0.5 * total[-1])]]) if total[-1] > 0.0 else 1.0
