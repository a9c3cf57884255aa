"""The onion descriptors: objects, or objects of each class, in each of a few shells around an object.

Baselines of the Descriptellation paper (Section IV-C), with its three shells of 10 m.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from descriptors.class_vectors import class_vectors
from descriptors.constellation import Constellations


class Onion:
    """Counts of objects in ``shells`` of equal width out to ``radius_m``, of any class."""

    name = "onion"

    def __init__(self, radius_m: float = 30.0, shells: int = 3) -> None:
        self.radius_m = radius_m
        self._shells = shells

    def describe(self, constellations: Constellations) -> NDArray[np.float32]:
        """Vectors (B, shells), from the inside out."""
        cells = constellations.owners * self._shells + _shell(constellations, self.radius_m, self._shells)
        counts = np.bincount(cells, minlength=len(constellations) * self._shells)
        return counts.reshape(len(constellations), self._shells).astype(np.float32)


class OnionHistogram:
    """``shells`` of equal width out to ``radius_m``; classes enter as fixed random vectors of ``class_length``."""

    name = "onion_histogram"

    def __init__(self, radius_m: float = 30.0, shells: int = 3, class_length: int = 64) -> None:
        self.radius_m = radius_m
        self._shells = shells
        self._class_length = class_length

    def describe(self, constellations: Constellations) -> NDArray[np.float32]:
        """Vectors (B, shells * class_length): the sums of the class vectors, shell by shell from the inside out."""
        shells = _shell(constellations, self.radius_m, self._shells)
        return count_classes(constellations, shells, self._shells, self._class_length)


def count_classes(
    constellations: Constellations, bins: NDArray[np.int64], count: int, class_length: int
) -> NDArray[np.float32]:
    """Sums (B, ``count`` * class_length) of the vectors of the neighbours' classes in each of the ``bins`` (P,)."""
    classes = len(constellations.vocabulary)
    cells = (constellations.owners * count + bins) * classes + constellations.labels
    counts = np.bincount(cells, minlength=len(constellations) * count * classes)
    histogram = counts.reshape(len(constellations), count, classes).astype(np.float32)
    described = histogram @ class_vectors(constellations.vocabulary, class_length)
    return np.asarray(described.reshape(len(constellations), count * class_length), dtype=np.float32)


def _shell(constellations: Constellations, radius_m: float, shells: int) -> NDArray[np.int64]:
    distances_m = np.hypot(constellations.positions[:, 0], constellations.positions[:, 1])
    return np.minimum((distances_m / radius_m * shells).astype(np.int64), shells - 1)
