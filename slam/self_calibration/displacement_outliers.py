"""Displacements of tracked objects without their outliers.

Residuals of real detectors have heavy tails: a stem that is cut off, a wrong match. Estimators with robust kernels give
them little weight, so the noise that they need is that of the others, and a mean square that holds the tails would be
several times too large. The objects of two scans have the motion between the scans in common, a shift and a turn, in
which odometry may err much at times; what a detection has beyond it is clipped, along and across the line of sight.
"""

from __future__ import annotations

import numpy as np

from slam.common.arrays import FloatArray, IntArray

OWN_CLIP = 3.0
"""Beyond the common motion displacements are clipped at that many robust standard deviations: 1 % of a Gaussian's mean
square goes with them.
"""
LEAST_OBJECTS = 5
"""Fewer objects of two scans do not tell their common motion from what each has beyond it."""
ROUNDS = 4


def without_outliers(displacements: FloatArray, offsets: FloatArray, pairs: IntArray) -> FloatArray:
    """Displacements (P, 2) m with what exceeds the common motion of their pair of scans clipped.

    Args:
        displacements: (P, 2) m.
        offsets: (P, 2) m of the objects from the body, in the same axes.
        pairs: (P,) ids of the pairs of scans.
    """
    _, group, counts = np.unique(pairs, return_inverse=True, return_counts=True)
    several = counts[group] >= LEAST_OBJECTS
    if not several.any():
        return displacements
    d, x, group = displacements[several], offsets[several], group[several]
    ranges = np.hypot(x[:, 0], x[:, 1])
    sights = x / np.maximum(ranges, 1e-12)[:, None]
    axes = np.stack([sights, np.stack([-sights[:, 1], sights[:, 0]], axis=1)], axis=1)  # along, across
    bins = np.digitize(ranges, np.quantile(ranges, (1 / 3, 2 / 3)))
    weights, clipped = np.ones(len(d)), d
    for _ in range(ROUNDS):
        common = _common_motion(d, x, group, weights)
        own = np.einsum("nij,nj->ni", axes, d - common)
        limits = _limits(own, bins)
        kept = np.clip(own, -limits, limits)
        clipped = common + np.einsum("nij,ni->nj", axes, kept)
        weights = np.min(np.minimum(limits / np.maximum(np.abs(own), 1e-300), 1.0), axis=1)
    found = displacements.copy()
    found[several] = clipped
    return found


def _common_motion(d: FloatArray, x: FloatArray, group: IntArray, weights: FloatArray) -> FloatArray:
    """What each displacement (N, 2) has of the shift and turn that fit its group best, by least squares."""

    def total(values: FloatArray) -> FloatArray:
        return np.bincount(group, weights * values).astype(np.float64)

    def centred(values: FloatArray) -> FloatArray:
        means = np.stack([total(values[:, 0]), total(values[:, 1])], axis=1) / norms[:, None]
        return np.asarray(values - means[group])

    norms = np.maximum(total(np.ones(len(d))), 1e-300)
    dx, dd = centred(x), centred(d)
    torques, inertias = total(dx[:, 0] * dd[:, 1] - dx[:, 1] * dd[:, 0]), total(np.einsum("ni,ni->n", dx, dx))
    turns = (torques / np.maximum(inertias, 1e-300))[group, None]
    return np.asarray(d - dd + turns * np.stack([-dx[:, 1], dx[:, 0]], axis=1))


def _limits(own: FloatArray, bins: IntArray) -> FloatArray:
    """(N, 2) m at which the parts along and across the line of sight are clipped, in each bin of range."""
    limits = np.zeros_like(own)
    for each in np.unique(bins).tolist():
        chosen = bins == each
        limits[chosen] = OWN_CLIP * 1.4826 * np.median(np.abs(own[chosen]), axis=0)
    return limits
