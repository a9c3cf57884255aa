"""KeyframeObservations of landmarks between two keyframes, summed up into one observation a landmark.

Over the two metres between keyframes the odometry is far better than a detection, so all measurements of a landmark in
that stretch are carried into the keyframe's frame and averaged by their information: the graph gets one factor where
the sensor gave five to twenty, at no loss.
"""

from __future__ import annotations

import numpy as np

from slam.backend.factors import Observation
from slam.common.arrays import IntArray
from slam.common.calibration import DetectionCalibration
from slam.frontend.input.scan import Scan

# More measurements than that from one pose, as of a robot that waits, add no information: they share their errors.
MAX_MEASUREMENTS = 20


class KeyframeObservations:
    """Running sums of information, one row a landmark."""

    def __init__(self) -> None:
        self._index: dict[int, int] = {}
        self._information = np.zeros((16, 3, 3))
        self._weighted = np.zeros((16, 3))
        self._count = np.zeros(16, dtype=np.int64)
        self._all_own = np.ones(16, dtype=np.bool_)

    def add(self, rows: IntArray, scan: Scan) -> None:
        """Add the measurements of a scan, given in the keyframe's frame, of the landmarks ``rows`` (N,), none twice."""
        indices = np.array([self._index.setdefault(row, len(self._index)) for row in rows.tolist()], dtype=np.int64)
        while len(self._index) > len(self._count):
            self._information = np.concatenate([self._information, np.zeros_like(self._information)])
            self._weighted = np.concatenate([self._weighted, np.zeros_like(self._weighted)])
            self._count = np.concatenate([self._count, np.zeros_like(self._count)])
            self._all_own = np.concatenate([self._all_own, np.ones_like(self._all_own)])
        information = np.linalg.inv(scan.covariances)
        self._information[indices] += information
        self._weighted[indices] += np.einsum("nij,nj->ni", information, scan.positions)
        self._count[indices] += 1
        self._all_own[indices] &= scan.has_own_covariance

    def observations(self, keyframe: int, config: DetectionCalibration) -> list[Observation]:
        """One observation a landmark.

        Where the message has no covariance, the correlation of its errors is unknown: then the configured error that
        all measurements share is added, which no average reduces, and the configured inflation applies.
        """
        count = len(self._index)
        covariances = np.linalg.inv(self._information[:count])
        means = np.einsum("nij,nj->ni", covariances, self._weighted[:count])
        covariances *= np.maximum(self._count[:count] / MAX_MEASUREMENTS, 1.0)[:, None, None]
        all_own = self._all_own[:count]
        covariances += np.where(all_own, 0.0, config.common_sigma_m**2)[:, None, None] * np.eye(3)
        inflations = np.where(all_own, 1.0, config.covariance_inflation)
        return [
            Observation(keyframe, row, means[index], covariances[index], float(inflations[index]))
            for row, index in self._index.items()
        ]
