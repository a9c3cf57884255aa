"""GOSMatch's descriptors: edges binned by the classes at their ends and by their length.

Zhu et al., GOSMatch: Graph-of-Semantics Matching for Detecting Loop Closures in 3D LiDAR Data, IROS 2020; its bins are
61 of 1 m, the last of which takes all longer edges. The original describes a scan and its vertices; as in the
Descriptellation paper (Section IV-C) both are taken over the constellation of each object here.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array

from descriptors.baselines.onion import count_classes
from descriptors.class_vectors import class_vectors
from descriptors.constellation import Constellations
from descriptors.learned.padded import pad_constellations

BINS = 61
BIN_M = 1.0
CHUNK = 64
"""Constellations whose edges are counted at a time, which bounds the memory."""


class GosmatchVertex:
    """The edges of the object itself; classes enter as fixed random vectors of ``class_length``."""

    name = "gosmatch_vertex"

    def __init__(self, radius_m: float = 30.0, class_length: int = 64) -> None:
        self.radius_m = radius_m
        self._class_length = class_length

    def describe(self, constellations: Constellations) -> NDArray[np.float32]:
        """Vectors (B, 61 * class_length), bin by bin from the shortest edges on."""
        lengths_m = np.hypot(constellations.positions[:, 0], constellations.positions[:, 1])
        return count_classes(constellations, _bin(lengths_m), BINS, self._class_length)


class GosmatchGraph:
    """All edges of the constellation; pairs of classes enter as fixed random vectors of ``pair_length``."""

    name = "gosmatch_graph"

    def __init__(self, radius_m: float = 30.0, pair_length: int = 64) -> None:
        self.radius_m = radius_m
        self._pair_length = pair_length

    def describe(self, constellations: Constellations) -> NDArray[np.float32]:
        """Vectors (B, 61 * pair_length), bin by bin from the shortest edges on."""
        described = np.zeros((len(constellations), BINS * self._pair_length), dtype=np.float32)
        vectors = _pair_vectors(constellations.vocabulary, self._pair_length)
        for start in range(0, len(constellations), CHUNK):
            rows = np.arange(start, min(start + CHUNK, len(constellations)))
            owners, bins, pairs = _edges(constellations[rows])
            edges = (np.ones(len(pairs), dtype=np.float32), (owners * BINS + bins, pairs))
            counts = coo_array(edges, shape=(len(rows) * BINS, len(vectors))).tocsr()
            described[rows] = (counts @ vectors).reshape(len(rows), -1)
        return described


def _edges(constellations: Constellations) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Constellation, bin and pair of classes, each (E,), of every edge, the centres' included."""
    padded = pad_constellations(constellations)
    plane = padded.positions[:, :, 0] + 1j * padded.positions[:, :, 1]
    first, second = np.triu_indices(plane.shape[1], k=1)
    owners, edges = np.nonzero(padded.present[:, first] & padded.present[:, second])
    lengths_m = np.abs(plane[owners, first[edges]] - plane[owners, second[edges]])
    labels = np.sort(np.stack([padded.labels[owners, first[edges]], padded.labels[owners, second[edges]]]), axis=0)
    return owners, _bin(lengths_m), labels[0] * len(constellations.vocabulary) + labels[1]


@lru_cache(maxsize=8)
def _pair_vectors(vocabulary: tuple[str, ...], length: int) -> NDArray[np.float32]:
    """Vectors (C * C, length) for each pair of classes by their names; the order of the two does not matter."""
    names = ["\0".join(sorted((a, b))) for a in vocabulary for b in vocabulary]
    return class_vectors(names, length)


def _bin(lengths_m: NDArray[np.float64] | NDArray[np.float32]) -> NDArray[np.int64]:
    return np.minimum((lengths_m / BIN_M).astype(np.int64), BINS - 1)
