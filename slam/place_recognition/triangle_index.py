"""Geometric hashing of triangles (Lamdan and Wolfson, ICCV 1988): which triangles of a map those of a query may be.

Triangles are sorted by their classes, their sense of rotation and their sides, so that those that a triangle of the
query may be are a few stretches of that list, however large the map is. It needs no classes: where every object is a
tree, the lengths of three sides still tell it from hundreds of others.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam.common.arrays import BoolArray, FloatArray, IntArray
from slam.place_recognition.triangles import Triangles, neighbour_triangles

BUDGET = 100_000
"""Candidates that are compared for a query. The triangles with the fewest candidates, which tell most, come first."""
STEPS = 16
"""Steps of the longest side within the tolerance: it is looked up as an interval and the others in whole cells."""
CELLS, CLASS_KEYS = 2**10, 2**20
_NEIGHBOUR_CELLS = np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1], indexing="ij"), axis=-1).reshape(-1, 2)


@dataclass(frozen=True, slots=True, eq=False)
class TriangleMatches:
    """C pairs of triangles of equal sides: ``query`` (C, 3) rows of the query, ``reference`` (C, 3) ids of the map,
    corner by corner.
    """

    query: IntArray
    reference: IntArray

    def __len__(self) -> int:
        return len(self.query)


class TriangleIndex:
    """Triangles of the objects of a map.

    Args:
        tolerance_m: how much a side may differ between query and map.
    """

    def __init__(self, tolerance_m: float) -> None:
        self.tolerance_m = tolerance_m
        self._vertices = np.zeros((0, 3), dtype=np.int32)
        self._sides = np.zeros((0, 3), dtype=np.float32)
        self._keys = np.zeros(0, dtype=np.int64)

    def __len__(self) -> int:
        """How many triangles there are."""
        return len(self._keys)

    def add(self, positions: FloatArray, labels: IntArray, ids: IntArray, centres: IntArray) -> None:
        """Add the triangles of some objects.

        Args:
            positions: (N, 3) m, z up: the objects with those around them.
            labels: (N,) classes.
            ids: (N,) numbers by which matches name them.
            centres: (C,) rows of the objects whose triangles are new.
        """
        triangles = neighbour_triangles(positions, centres)
        keys = self._key(triangles, labels, triangles.sides)
        order = np.argsort(keys, kind="stable")
        at = np.searchsorted(self._keys, keys[order], side="right")
        self._keys = np.insert(self._keys, at, keys[order])
        self._vertices = np.insert(self._vertices, at, ids[triangles.vertices[order]].astype(np.int32), axis=0)
        self._sides = np.insert(self._sides, at, triangles.sides[order].astype(np.float32), axis=0)

    def match(self, positions: FloatArray, labels: IntArray, usable: BoolArray) -> TriangleMatches:
        """Triangles of the map with the classes and sides of those of a query.

        Args:
            positions: (N, 3) m of the query, z up.
            labels: (N,) classes.
            usable: by id, whether an object of the map may be matched.
        """
        triangles = neighbour_triangles(positions)
        query, entries = self._candidates(triangles, labels)
        differences = np.take(triangles.sides, query, axis=0)
        differences -= np.take(self._sides, entries, axis=0)
        alike = np.flatnonzero(_all_of_three(np.abs(differences) <= self.tolerance_m))
        query, reference = query[alike], np.take(self._vertices, entries[alike], axis=0)
        is_usable = _all_of_three(np.take(usable, reference))
        return TriangleMatches(triangles.vertices[query[is_usable]], reference[is_usable].astype(np.int64))

    def _candidates(self, triangles: Triangles, labels: IntArray) -> tuple[IntArray, IntArray]:
        """Pairs (C,) of a triangle of the query and one of the map in its cells, at most ``BUDGET`` of them."""
        shifts = np.zeros((len(_NEIGHBOUR_CELLS), 3))
        shifts[:, :2] = _NEIGHBOUR_CELLS * self.tolerance_m
        sides = triangles.sides[:, None] + shifts  # (T, 9, 3)
        interval = np.array([0.0, 0.0, self.tolerance_m])
        first = np.searchsorted(self._keys, self._key(triangles, labels, sides - interval), side="left")
        last = np.searchsorted(self._keys, self._key(triangles, labels, sides + interval), side="right")
        counts = np.where((sides >= 0.0).all(axis=2), np.maximum(last - first, 0), 0)
        totals = counts.sum(axis=1)
        order = np.argsort(totals, kind="stable")
        chosen = np.sort(order[: np.searchsorted(np.cumsum(totals[order]), BUDGET, side="right")])
        lengths = counts[chosen].ravel()
        stretch_starts = np.cumsum(lengths) - lengths
        entries = np.arange(int(lengths.sum())) + np.repeat(first[chosen].ravel() - stretch_starts, lengths)
        return np.repeat(chosen, totals[chosen]), entries

    def _key(self, triangles: Triangles, labels: IntArray, sides: FloatArray) -> IntArray:
        """Sort keys (T, ...) of triangles with these ``sides`` (T, ..., 3) m; different triangles may share one."""
        classes = labels[triangles.vertices]
        kind = ((classes[:, 0] * 1021 + classes[:, 1]) * 1021 + classes[:, 2]) % CLASS_KEYS * 2 + triangles.is_left
        kind = kind.reshape(-1, *(1,) * (sides.ndim - 2))
        cells = np.floor(np.maximum(sides, 0.0) / self.tolerance_m)
        a = np.minimum(cells[..., 0], CELLS - 1).astype(np.int64)
        b = np.minimum(cells[..., 1], CELLS - 1).astype(np.int64)
        steps = np.floor(np.maximum(sides[..., 2], 0.0) * (STEPS / self.tolerance_m))
        c = np.minimum(steps, STEPS * CELLS - 1).astype(np.int64)
        return np.asarray(((kind * CELLS + a) * CELLS + b) * (STEPS * CELLS) + c)


def _all_of_three(holds: BoolArray) -> BoolArray:
    """Whether all of (C, 3) hold, sooner than a reduction over so short an axis."""
    return np.asarray(holds[:, 0] & holds[:, 1] & holds[:, 2])
