"""Landmarks of a prior map that are no longer there: the robot passed them and never saw them."""

from __future__ import annotations

from collections import Counter

import numpy as np

from slam.common.arrays import IntArray

MIN_CLOSURES = 6
"""A landmark that was passed at that many closures and matched at none is missing."""


class MissingLandmarks:
    """How often each landmark was passed, and which were matched at all."""

    def __init__(self) -> None:
        self._passed: Counter[int] = Counter()
        self._matched: set[int] = set()

    def add(self, passed: IntArray, matched: IntArray) -> None:
        """Add a closure: rows of the landmarks that the robot passed before it, and of those that it matched."""
        self._passed.update(passed.tolist())
        self._matched.update(matched.tolist())

    def rows(self) -> IntArray:
        """Rows (K,) of the missing landmarks."""
        missing = [row for row, count in self._passed.items() if count >= MIN_CLOSURES and row not in self._matched]
        return np.array(sorted(missing), dtype=np.int64)
