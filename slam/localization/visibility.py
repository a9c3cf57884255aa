"""Visibility of landmarks: the probability of an observation by range and bearing, learned on the drive."""

from __future__ import annotations

import numpy as np

from slam.common.arrays import BoolArray, FloatArray, IntArray

RANGE_CELLS, BEARING_CELLS = 6, 8
PRIOR_EXPECTED = 2.0
"""Landmarks that are assumed not to have been seen in a cell: it may be hidden from the sensor as long as nothing was
seen there.
"""


class Visibility:
    """Cells of range and bearing up to ``range_m``, and the share of the landmarks in each that were seen."""

    def __init__(self, range_m: float) -> None:
        self._range_m = range_m
        # The last cell is all that is out of range: nothing is learned there.
        self._expected = np.full(RANGE_CELLS * BEARING_CELLS + 1, PRIOR_EXPECTED)
        self._seen = np.zeros(RANGE_CELLS * BEARING_CELLS + 1)

    def learn(self, positions: FloatArray, seen: BoolArray) -> None:
        """Add landmarks at ``positions`` (N, 2) m in the frame of the body: which of them were seen (N,)."""
        cells = self._cells(positions)
        inside = cells < len(self._expected) - 1
        np.add.at(self._expected, cells[inside], 1.0)
        np.add.at(self._seen, cells[inside], seen[inside].astype(np.float64))

    def probability(self, positions: FloatArray) -> FloatArray:
        """Probability (N,) that landmarks at ``positions`` (N, 2) m are seen; 0 out of range."""
        return np.asarray((self._seen / self._expected)[self._cells(positions)])

    def _cells(self, positions: FloatArray) -> IntArray:
        ranges = np.hypot(positions[:, 0], positions[:, 1])
        bearings = np.arctan2(positions[:, 1], positions[:, 0])
        ring = (ranges / self._range_m * RANGE_CELLS).astype(np.int64)
        sector = ((bearings + np.pi) / (2.0 * np.pi) * BEARING_CELLS).astype(np.int64) % BEARING_CELLS
        return np.where(ring < RANGE_CELLS, ring * BEARING_CELLS + sector, RANGE_CELLS * BEARING_CELLS)
