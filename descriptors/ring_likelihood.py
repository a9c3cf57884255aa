"""How likely an object of the map makes what is seen around an object: the descriptor that loop closing uses.

The neighbours of an observed object are taken as independent, each by class and horizontal distance (naive Bayes). A
neighbour of class c at distance d speaks for object m of the map, against an object anywhere, with

    log( 1 + (1 - e) / e * density_m(c, d) / density(d) )   nats,

where density_m adds up one kernel for each neighbour of class c that m has in the map, density is what an average place
has of any one class, and e the share of neighbours that are not where the map has them. The vector of m holds these
numbers for every class and ring; what a query scores against m is the sum of the entries that its own neighbours fall
into. So objects that the query does not see (out of range, hidden, missed) cost nothing, which no distance between
histograms can say. The kernel has a narrow and a wide part: exact detections are distinguished, noisy ones still
found.

Nothing in it turns with the sensor or depends on the order of the objects.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from descriptors.constellation import Constellations

CHUNK = 512
"""Constellations of up to 64 classes that are described at a time, which bounds the memory."""
RADIUS_M, RING_M = 60.0, 0.5
SIGMAS_M = 0.3, 1.2
"""Of the narrow and the wide part of a kernel, which have equal shares."""
MISS_PROBABILITY = 0.1
"""The share e above, 1 - P_D."""
OBJECTS_PER_KM2 = 500.0
"""Of one class at an average place."""
REACH_SIGMAS = 4.0
MIN_DENSITY_PER_M = 1e-3


class RingLikelihood:
    """Rings of ``RING_M`` out to ``radius_m``, the diameter of what a sensor sees: for an object at its edge all others
    are neighbours.
    """

    name = "ring_likelihood"
    min_nats = 0.0
    radius_m = near_m = RADIUS_M
    rings = round(RADIUS_M / RING_M)

    def __init__(self) -> None:
        middles_m = (np.arange(self.rings) + 0.5) * RING_M
        expected = 2.0 * np.pi * middles_m * OBJECTS_PER_KM2 * 1e-6  # of one class, per metre of distance
        self._odds = (1.0 - MISS_PROBABILITY) / MISS_PROBABILITY / (expected + MIN_DENSITY_PER_M)

    def describe(self, constellations: Constellations) -> NDArray[np.float32]:
        """Vectors (B, C * rings) in nats: for each class of the vocabulary the rings from the inside out."""
        size = len(constellations.vocabulary) * self.rings
        described = np.zeros((len(constellations), size), dtype=np.float32)
        step = count_at_a_time(constellations)
        for start in range(0, len(constellations), step):
            end = min(start + step, len(constellations))
            neighbours = slice(constellations.offsets[start], constellations.offsets[end])
            density = self._density(constellations, neighbours, start, end)
            described[start:end] = np.log1p(density * np.tile(self._odds, len(constellations.vocabulary)))
        return described

    def cells(self, constellations: Constellations) -> NDArray[np.int64]:
        """Which entry (P,) of a vector each neighbour falls into, where it is observed."""
        return constellations.labels * self.rings + self._ring(_distances(constellations.positions))

    def max_nats(self, constellations: Constellations) -> NDArray[np.float32]:
        """What a query (B,) would score against an object whose neighbours stand exactly where they were seen."""
        peak = sum(1.0 / (np.sqrt(2.0 * np.pi) * s) for s in SIGMAS_M) / len(SIGMAS_M)
        best = np.log1p(self._odds * peak)[self._ring(_distances(constellations.positions))]
        total = np.bincount(constellations.owners, weights=best, minlength=len(constellations))
        return np.asarray(total, dtype=np.float32)

    def _ring(self, distances_m: NDArray[np.float64]) -> NDArray[np.int64]:
        return np.minimum((distances_m / RING_M).astype(np.int64), self.rings - 1)

    def _density(self, constellations: Constellations, neighbours: slice, start: int, end: int) -> NDArray[np.float32]:
        """Neighbours per metre of distance (end - start, C * rings)."""
        distances_m = _distances(constellations.positions[neighbours])
        counts = np.diff(constellations.offsets[start : end + 1])
        rows = np.repeat(np.arange(end - start), counts) * len(constellations.vocabulary)
        reach = int(np.ceil(REACH_SIGMAS * max(SIGMAS_M) / RING_M))
        rings = self._ring(distances_m)[:, None] + np.arange(-reach, reach + 1)  # (P, 2 reach + 1)
        offsets_m = (rings + 0.5) * RING_M - distances_m[:, None]
        kernel = sum(np.exp(-0.5 * (offsets_m / s) ** 2) / (np.sqrt(2.0 * np.pi) * s) for s in SIGMAS_M)
        kernel = np.where((rings >= 0) & (rings < self.rings), kernel / len(SIGMAS_M), 0.0)
        entries = (rows + constellations.labels[neighbours])[:, None] * self.rings + np.clip(rings, 0, self.rings - 1)
        size = (end - start) * len(constellations.vocabulary) * self.rings
        density = np.bincount(entries.ravel(), weights=kernel.ravel(), minlength=size)
        return np.asarray(density.reshape(end - start, -1), dtype=np.float32)


def count_at_a_time(constellations: Constellations) -> int:
    """How many to describe at once: fewer where a vector is long for its many classes."""
    return int(np.clip(CHUNK * 64 // max(len(constellations.vocabulary), 1), 1, CHUNK))


def _distances(positions: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.hypot(positions[:, 0], positions[:, 1])
