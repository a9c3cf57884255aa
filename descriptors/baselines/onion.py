"""The onion histogram: objects of each class in each of a few shells around an object.

A baseline of the Descriptellation paper (Section IV-B): shells of equal spacing, a histogram of semantic classes in
each.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from descriptors.class_vectors import class_vectors
from descriptors.constellation import Constellations


class OnionHistogram:
    """``shells`` of equal width out to ``radius_m``; classes enter as fixed random vectors of ``class_length``."""

    name = "onion_histogram"

    def __init__(self, radius_m: float = 30.0, shells: int = 10, class_length: int = 16) -> None:
        self.radius_m = radius_m
        self._shells = shells
        self._class_length = class_length

    @property
    def length(self) -> int:
        """How many numbers a vector has."""
        return self._shells * self._class_length

    def describe(self, constellations: Constellations) -> NDArray[np.float32]:
        """Vectors (B, length): the sums of the class vectors, shell by shell from the inside out."""
        distances = np.hypot(constellations.positions[:, 0], constellations.positions[:, 1])
        shells = np.minimum((distances / self.radius_m * self._shells).astype(np.int64), self._shells - 1)
        classes = len(constellations.vocabulary)
        cells = (constellations.owners * self._shells + shells) * classes + constellations.labels
        counts = np.bincount(cells, minlength=len(constellations) * self._shells * classes)
        histogram = counts.reshape(len(constellations), self._shells, classes).astype(np.float32)
        described = histogram @ class_vectors(constellations.vocabulary, self._class_length)
        return np.asarray(described.reshape(len(constellations), self.length), dtype=np.float32)
