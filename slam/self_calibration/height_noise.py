"""Noise of the heights of detections, of each object and common to all objects in view.

A tracked object that stands still seems to rise by dz between two scans. For two objects k, l of the same two scans
E[dz_k dz_l] = 2 c, with c the variance of what they have in common, and E[dz_k^2] = 2 c + 2 v, with v that of the
object alone. What is in common may be the odometry's or the detector's (heights above the ground on a slope, a sensor
that tilts); it is put down to the detector, because gravity and the ground hold the odometry.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam.common.arrays import IntArray
from slam.self_calibration.object_tracks import ObjectTracks
from slam.self_calibration.variance_components import CLIP, LEAST_PAIRS


@dataclass(frozen=True, slots=True)
class HeightNoise:
    """Variances [m^2] of the height of a detection: ``own`` of the object, ``common`` to all objects in view."""

    own: float = 0.0
    common: float = 0.0


def estimate_height_noise(tracks: ObjectTracks) -> HeightNoise:
    """The largest variances over lags of 1, 2, 4, ... detections; zero where too few objects could be tracked."""
    own, common, lag = 0.0, 0.0, 1
    while lag < len(tracks.track):
        first = tracks.followed(lag)
        if len(first) < LEAST_PAIRS:
            break
        total_of_lag, common_of_lag = _variances(tracks, first, first + lag)
        common = max(common, common_of_lag)
        own = max(own, total_of_lag - common_of_lag)
        lag *= 2
    return HeightNoise(own, common)


def _variances(tracks: ObjectTracks, first: IntArray, second: IntArray) -> tuple[float, float]:
    """Variance of the heights and that of their common part, from pairs (P,) of detections."""
    dz = tracks.heights[second] - tracks.heights[first]
    limit = CLIP * 1.4826 * float(np.median(np.abs(dz)))
    dz = np.clip(dz, -limit, limit)
    key = tracks.scan[first] * (int(tracks.scan.max()) + 1) + tracks.scan[second]
    _, group, count = np.unique(key, return_inverse=True, return_counts=True)
    products = np.bincount(group, dz) ** 2 - np.bincount(group, dz**2)  # sum over ordered pairs of two objects
    pairs = float(np.sum(count * (count - 1)))
    common = max(float(products.sum()) / pairs, 0.0) if pairs >= LEAST_PAIRS else 0.0
    return 0.5 * float(np.mean(dz**2)), 0.5 * common
