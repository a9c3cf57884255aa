"""Sightings of landmarks between two keyframes, summed up into one observation a landmark.

Over the two metres between keyframes the odometry is far better than a detection, so all sightings of a landmark in
that stretch are carried into the keyframe's frame and averaged by their information: the graph gets one factor where
the sensor gave five to twenty, at no loss.
"""

from __future__ import annotations

import numpy as np

from slam.config import DetectionConfig
from slam.factors import Observation
from slam.geometry import FloatArray, IntArray


class Sightings:
    """Running sums of information, one row a landmark."""

    def __init__(self) -> None:
        self._place: dict[int, int] = {}
        self._information = np.zeros((16, 3, 3))
        self._weighted = np.zeros((16, 3))
        self._have_own_covariances = True

    def add(
        self, rows: IntArray, positions: FloatArray, covariances: FloatArray, *, have_own_covariances: bool
    ) -> None:
        """Add sightings of landmarks ``rows`` (N,), none twice: (N, 3) m in the keyframe's frame, (N, 3, 3) m^2.

        ``have_own_covariances``: the detector gave them, so they are taken at its word.
        """
        self._have_own_covariances &= have_own_covariances
        places = np.array([self._place.setdefault(row, len(self._place)) for row in rows.tolist()], dtype=np.int64)
        while len(self._place) > len(self._information):
            self._information = np.concatenate([self._information, np.zeros_like(self._information)])
            self._weighted = np.concatenate([self._weighted, np.zeros_like(self._weighted)])
        information = np.linalg.inv(covariances)
        self._information[places] += information
        self._weighted[places] += np.einsum("nij,nj->ni", information, positions)

    def observations(self, keyframe: int, config: DetectionConfig) -> list[Observation]:
        """One observation a landmark.

        Where the detector gave no covariances, nobody knows how its errors are correlated: then the configured error
        that all sightings share, which no average removes, is added, and the configured redundancy applies.
        """
        count = len(self._place)
        covariances = np.linalg.inv(self._information[:count])
        means = np.einsum("nij,nj->ni", covariances, self._weighted[:count])
        redundancy = 1.0
        if not self._have_own_covariances:
            covariances = covariances + config.common_sigma_m**2 * np.eye(3)
            redundancy = config.redundancy
        return [
            Observation(keyframe, row, means[place], covariances[place], redundancy)
            for row, place in self._place.items()
        ]
