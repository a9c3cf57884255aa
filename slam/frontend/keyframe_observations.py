"""Sightings of landmarks between two keyframes, summed up into one observation a landmark.

Over the two metres between keyframes the odometry is far better than a detection, so all sightings of a landmark in
that stretch are carried into the keyframe's frame and averaged by their information: the graph gets one factor where
the sensor gave five to twenty, at no loss.
"""

from __future__ import annotations

import numpy as np

from slam.backend.factors import Observation
from slam.common.arrays import IntArray
from slam.common.config import DetectionConfig
from slam.frontend.scan import Scan

# More sightings than that from one place, as of a robot that waits, say nothing new: their errors are the same.
MAX_SIGHTINGS = 20


class Sightings:
    """Running sums of information, one row a landmark."""

    def __init__(self) -> None:
        self._place: dict[int, int] = {}
        self._information = np.zeros((16, 3, 3))
        self._weighted = np.zeros((16, 3))
        self._count = np.zeros(16, dtype=np.int64)
        self._all_own = np.ones(16, dtype=np.bool_)

    def add(self, rows: IntArray, scan: Scan) -> None:
        """Add the sightings of a scan, given in the keyframe's frame, of the landmarks ``rows`` (N,), none twice."""
        places = np.array([self._place.setdefault(row, len(self._place)) for row in rows.tolist()], dtype=np.int64)
        while len(self._place) > len(self._count):
            self._information = np.concatenate([self._information, np.zeros_like(self._information)])
            self._weighted = np.concatenate([self._weighted, np.zeros_like(self._weighted)])
            self._count = np.concatenate([self._count, np.zeros_like(self._count)])
            self._all_own = np.concatenate([self._all_own, np.ones_like(self._all_own)])
        information = np.linalg.inv(scan.covariances)
        self._information[places] += information
        self._weighted[places] += np.einsum("nij,nj->ni", information, scan.positions)
        self._count[places] += 1
        self._all_own[places] &= scan.has_own_covariance

    def observations(self, keyframe: int, config: DetectionConfig) -> list[Observation]:
        """One observation a landmark.

        Where the detector gave no covariance, nobody knows how its errors are correlated: then the configured error
        that all sightings share, which no average removes, is added, and the configured redundancy applies.
        """
        count = len(self._place)
        covariances = np.linalg.inv(self._information[:count])
        means = np.einsum("nij,nj->ni", covariances, self._weighted[:count])
        covariances *= np.maximum(self._count[:count] / MAX_SIGHTINGS, 1.0)[:, None, None]
        all_own = self._all_own[:count]
        covariances += np.where(all_own, 0.0, config.common_sigma_m**2)[:, None, None] * np.eye(3)
        redundancies = np.where(all_own, 1.0, config.redundancy)
        return [
            Observation(keyframe, row, means[place], covariances[place], float(redundancies[place]))
            for row, place in self._place.items()
        ]
