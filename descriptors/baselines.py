"""Descriptors to compare with: one of the literature, and one without information, the lower bound of a comparison.

GOSMatch's vertex descriptor: the edges of an object, binned by the class at their other end and by their length.

Zhu et al., GOSMatch: Graph-of-Semantics Matching for Detecting Loop Closures in 3D LiDAR Data, IROS 2020; its bins are
61 of 1 m, the last of which takes all longer edges. The original describes the vertices of a scan; as in the
Descriptellation paper (Section IV-C) the constellation of each object takes the place of the scan here.
"""

import numpy as np

from descriptors.arrays import Float32Array
from descriptors.class_vectors import class_vectors
from descriptors.constellation import Constellations

BINS = 61


class GosmatchVertex:
    """Classes enter as fixed random vectors."""

    name = "gosmatch_vertex"
    radius_m = 30.0

    def describe(self, constellations: Constellations) -> Float32Array:
        """Vectors (B, 61 * 64): the sums of the class vectors, from the shortest edges on."""
        classes = len(constellations.vocabulary)
        lengths_m = np.hypot(*constellations.positions[:, :2].T)
        bins = np.minimum(lengths_m.astype(np.int64), BINS - 1)
        cells = (constellations.owners * BINS + bins) * classes + constellations.labels
        counts = np.bincount(cells, minlength=len(constellations) * BINS * classes)
        histogram = counts.reshape(len(constellations), BINS, classes).astype(np.float32)
        vectors = class_vectors(constellations.vocabulary, length=64)
        return (histogram @ vectors).reshape(len(constellations), BINS * vectors.shape[1])


class RandomVector:
    """Random numbers, the same ones for the same calls in the same order."""

    name = "random"
    radius_m = 30.0
    length = 16

    def __init__(self) -> None:
        self._rng = np.random.default_rng(0)

    def describe(self, constellations: Constellations) -> Float32Array:
        """Vectors (B, length) that do not depend on the constellations."""
        return self._rng.normal(size=(len(constellations), self.length)).astype(np.float32)
