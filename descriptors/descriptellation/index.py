"""The index of the Descriptellation paper: all objects of a map, of any class."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import pdist

from descriptors.constellation import Constellations
from descriptors.index import VectorIndex
from descriptors.learned.descriptor import LearnedDescriptor

MAX_OBJECTS = 2000
"""Of a larger map the mean distance is that of every second, third ... object."""


class PaperIndex(VectorIndex):
    """Nearest neighbours in L2 over the whole map, on graphs of its mean node distance (Sections III-A and III-D).

    In a map that grows, an object is described with the mean distance of the objects that are there by then.
    """

    def __init__(self, descriptor: LearnedDescriptor) -> None:
        super().__init__(descriptor, of_own_class=False)
        self._network = descriptor
        self._centres = np.zeros((0, 3))

    def add(self, constellations: Constellations) -> NDArray[np.int64]:
        """Add entries; returns their numbers (B,)."""
        self._centres = np.vstack([self._centres, constellations.centres])
        self._network.set_edge_length(mean_distance_m(self._centres))
        return super().add(constellations)


def mean_distance_m(positions: NDArray[np.float64]) -> float:
    """Mean distance of two of the objects (N, 3) m; 0 where there are fewer than two."""
    some = positions[:: -(-len(positions) // MAX_OBJECTS) or 1]
    return float(pdist(some).mean()) if len(some) > 1 else 0.0
