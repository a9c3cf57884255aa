"""Bias of observed centroids towards the sensor, class by class.

Only the near half of an object is visible, so that its centroid is too near by some b: it is at p and is
seen at p - b u, u the unit vector of the viewing ray. Between two scans with rays u1 and u2 it seems to move by
-b (u2 - u1), which regression finds (robustly, by Cauchy's weights). All objects of a class share b, and so its error:
it does not average out over the objects in view.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slam.common.arrays import FloatArray
from slam.self_calibration.corrections import CAUCHY, MIN_PAIRS, ROUNDS
from slam.self_calibration.object_tracks import ObjectTracks
from slam.self_calibration.variance_components import BLOCKS

LEAST_VIEW_CHANGE = 0.1
"""Rays that differ less do not determine the bias."""


def centroid_biases(tracks: ObjectTracks) -> FloatArray:
    """Bias (C,) m of each class, 0 where there is none that is significant."""
    count = int(tracks.labels.max()) + 1 if len(tracks.labels) else 0
    biases = np.zeros(count)
    first, second = tracks.pairs(4, 8, 16)
    is_turned = np.linalg.norm(tracks.rays[second] - tracks.rays[first], axis=1) > LEAST_VIEW_CHANGE
    first, second = first[is_turned], second[is_turned]
    turned = tracks.rays[first] - tracks.rays[second]
    moved = tracks.points[second] - tracks.points[first]
    block = tracks.scan[second] * BLOCKS // (int(tracks.scan.max()) + 1) if len(second) else second
    for label in range(count):
        chosen = tracks.labels[first] == label
        if int(chosen.sum()) < MIN_PAIRS:
            continue
        found = _regress(turned[chosen], moved[chosen])
        parts = [
            _regress(turned[chosen & (block != each)], moved[chosen & (block != each)])
            for each in np.unique(block[chosen]).tolist()
            if np.any(chosen & (block != each))
        ]
        if len(parts) < BLOCKS // 2:
            continue
        error = np.sqrt(len(parts) - 1) * np.std(parts)
        biases[label] = found if found > 4.0 * error else 0.0
    return biases


def without_bias(tracks: ObjectTracks, biases: FloatArray) -> ObjectTracks:
    """The tracks with each detection moved outwards by the bias of its class."""
    outwards = biases[tracks.labels][:, None] * tracks.rays
    return replace(tracks, offsets=tracks.offsets + outwards, points=tracks.points + outwards)


def _regress(x: FloatArray, y: FloatArray) -> float:
    """Slope of y (P, 2) over x (P, 2), robustly."""
    x, y = x.ravel(), y.ravel()
    weights = np.ones_like(x)
    slope = 0.0
    for _ in range(ROUNDS):
        weighted = weights * x
        slope = np.sum(weighted * y) / max(np.sum(weighted * x), 1e-300)
        residuals = y - slope * x
        scale = CAUCHY * 1.4826 * np.median(np.abs(residuals)) + 1e-12
        weights = 1.0 / (1.0 + (residuals / scale) ** 2)
    return slope
