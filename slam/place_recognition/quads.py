"""Quads of neighbouring objects: four objects and where they are relative to one another.

The two farthest apart are the base; the other two have their coordinates in its frame (Lang et al., Astrometry.net, AJ
2010, there without a scale). These five lengths tell a quad from thousands of others, without classes too.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, permutations

import numpy as np
from scipy.spatial import cKDTree

from slam.common.arrays import ComplexArray, FloatArray, IntArray

NEIGHBOURS = 6
"""Objects around each one that make quads with it."""
_TRIPLES = np.array(list(combinations(range(NEIGHBOURS), 3)))
_ORDERS = np.array(list(permutations(range(4))))
"""Ways to name the corners of a quad: base, base, and the other two."""


@dataclass(frozen=True, slots=True, eq=False)
class Quads:
    """Q quads: ``vertices`` (Q, 4) rows of the objects: the ends of the base, then the other two; ``lengths`` (Q, 5) m:
    of the base, and x and y of the other two in its frame.
    """

    vertices: IntArray
    lengths: FloatArray

    def __len__(self) -> int:
        return len(self.vertices)


def neighbour_sets(positions: FloatArray, centres: IntArray, tree: cKDTree) -> IntArray:
    """Sets (Q, 4) of an object and three of its nearest neighbours, each row ascending; some occur more than once.

    Args:
        positions: (N, 2) m, horizontal.
        centres: (C,) the objects whose quads are wanted.
        tree: of the positions.
    """
    count = min(NEIGHBOURS, len(positions) - 1)
    triples = _TRIPLES[(count > _TRIPLES).all(axis=1)]
    if not len(triples) or not len(centres):
        return np.zeros((0, 4), dtype=np.int64)
    # The object itself is the first, or one that shares its position.
    nearest = np.asarray(tree.query(positions[centres], k=count + 1)[1], dtype=np.int64)[:, 1:]
    others = nearest[:, triples].reshape(-1, 3)
    sets = np.column_stack([np.repeat(centres, len(triples)), others])
    sets.sort(axis=1)
    return sets[(np.diff(sets, axis=1) > 0).all(axis=1)]


def canonical_quads(plane: ComplexArray, sets: IntArray) -> Quads:
    """The quads of sets (Q, 4) of objects with positions ``plane`` (N,), corners in the order that the rule demands:
    the base is the longest side, the middle of the others lies in the first half of it, and the third corner
    before the fourth.
    """
    vertices, lengths, _ = _ordered(plane, sets, 0.0)
    return Quads(vertices, lengths)


def possible_quads(plane: ComplexArray, sets: IntArray, tolerance_m: float) -> Quads:
    """The same with all orders of the corners that the rule may demand once the lengths change by ``tolerance_m``."""
    vertices, lengths, _ = _ordered(plane, sets, tolerance_m)
    return Quads(vertices, lengths)


def _ordered(plane: ComplexArray, sets: IntArray, tolerance_m: float) -> tuple[IntArray, FloatArray, IntArray]:
    corners = plane[sets]
    first, second = np.triu_indices(4, 1)
    longest = np.abs(corners[:, first] - corners[:, second]).max(axis=1, initial=0.0)
    vertices, lengths, origins = [], [], []
    for order in _ORDERS:
        a, b, c, d = (corners[:, corner] for corner in order)
        base = b - a
        length = np.abs(base)
        rows = np.flatnonzero((length >= longest - tolerance_m) & (length > 0.0))
        turn = (base[rows] / length[rows]).conj()
        c_along, d_along = (c[rows] - a[rows]) * turn, (d[rows] - a[rows]) * turn
        fits = (c_along.real + d_along.real <= length[rows] + tolerance_m) & (
            c_along.real <= d_along.real + tolerance_m
        )
        rows, c_along, d_along = rows[fits], c_along[fits], d_along[fits]
        vertices.append(sets[rows][:, order])
        lengths.append(np.column_stack([length[rows], c_along.real, c_along.imag, d_along.real, d_along.imag]))
        origins.append(rows)
    return np.concatenate(vertices), np.concatenate(lengths), np.concatenate(origins)
