"""Which entries of an index a constellation may be: nearest neighbours in descriptor space."""

import numpy as np

from descriptors.arrays import BoolArray, Float32Array, IntArray, frozen
from descriptors.constellation import Constellations
from descriptors.descriptor import Descriptor


@frozen
class Matches:
    """Pairs (query, entry) with their distance, all (C,), query by query, the nearest first."""

    queries: IntArray
    entries: IntArray
    distances: Float32Array


class VectorIndex:
    """Compares vectors by their Euclidean distance. Exhaustive search: one matrix product a query batch.

    ``of_own_class``: only entries of the class of the query are its matches; ``radius_m``: how far neighbours count.
    """

    def __init__(self, descriptor: Descriptor, *, of_own_class: bool = True) -> None:
        self._descriptor, self.radius_m = descriptor, descriptor.radius_m
        self._of_own_class = of_own_class
        self._vectors = np.zeros((0, 0), dtype=np.float32)
        self._labels = np.zeros(0, dtype=np.int64)

    def __len__(self) -> int:
        return len(self._labels)

    @property
    def nbytes(self) -> int:
        """Memory of the vectors and the classes."""
        return self._vectors.nbytes + self._labels.nbytes

    def add(self, constellations: Constellations) -> None:
        """Add entries, which are numbered in their order."""
        vectors = self._descriptor.describe(constellations)
        self._vectors = np.concatenate([self._vectors, vectors]) if len(self) else vectors
        self._labels = np.concatenate([self._labels, constellations.centre_labels])

    def search(self, constellations: Constellations, k: int, allowed: BoolArray) -> Matches:
        """Up to ``k`` nearest entries for each query among the ``allowed`` (size,) ones.

        Ties go to the lower number.
        """
        vectors, labels = self._descriptor.describe(constellations), constellations.centre_labels
        squares = vectors @ self._vectors.T
        squares *= -2.0
        squares += np.einsum("ij,ij->i", self._vectors, self._vectors)
        squares[:, ~allowed] = np.inf
        if self._of_own_class:
            squares[labels[:, None] != self._labels] = np.inf
        nearest = np.argsort(squares, axis=1, kind="stable")[:, :k]
        found = np.take_along_axis(squares, nearest, axis=1)
        queries, places = np.nonzero(np.isfinite(found))
        own = np.einsum("ij,ij->i", vectors, vectors)
        distances = np.sqrt(np.maximum(found[queries, places] + own[queries], 0.0))
        return Matches(queries, nearest[queries, places], distances)
