"""Triangles of neighbouring objects: what is the same from wherever they are seen, with or without classes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from slam.common.arrays import FloatArray, IntArray

NEIGHBOURS = 8
"""Objects around each one that make triangles with it. Where two of three objects are found again, so are the three
corners of 30 % of the triangles, and most of an object's nearest neighbours are among its eight nearest."""


@dataclass(frozen=True, slots=True, eq=False)
class Triangles:
    """T triangles: ``vertices`` (T, 3) rows of the objects, each opposite to its side; ``sides`` (T, 3) m, horizontal,
    ascending; ``is_left`` (T,): whether the three vertices turn to the left, seen from above.
    """

    vertices: IntArray
    sides: FloatArray
    is_left: IntArray

    def __len__(self) -> int:
        return len(self.vertices)


def neighbour_triangles(
    positions: FloatArray, centres: IntArray | None = None, *, neighbours: int = NEIGHBOURS
) -> Triangles:
    """Each triangle of an object and two of its nearest ``neighbours``, once.

    Args:
        positions: (N, 3) m, z up; fewer than three have no triangle.
        centres: (C,) the objects whose triangles are wanted, by default all.
        neighbours: horizontally nearest objects of any class that count.
    """
    rows = np.arange(len(positions)) if centres is None else centres
    count = min(neighbours, len(positions) - 1)
    if count < 2 or len(rows) == 0:
        return Triangles(np.zeros((0, 3), np.int64), np.zeros((0, 3)), np.zeros(0, np.int64))
    nearest = np.asarray(cKDTree(positions[:, :2]).query(positions[rows, :2], k=count + 1)[1], dtype=np.int64)
    # The object itself is the first, or one that shares its position.
    first, second = np.triu_indices(count, 1)
    vertices = np.stack(
        [np.repeat(rows, len(first)), nearest[:, first + 1].ravel(), nearest[:, second + 1].ravel()], axis=1
    )
    vertices.sort(axis=1)
    vertices = vertices[(vertices[:, 0] != vertices[:, 1]) & (vertices[:, 1] != vertices[:, 2])]
    vertices = vertices[np.lexsort(vertices.T[::-1])]
    repeats = (vertices[1:] == vertices[:-1]).all(axis=1)
    vertices = vertices[~np.concatenate([[False], repeats])[: len(vertices)]]
    plane = positions[:, 0] + 1j * positions[:, 1]
    corners = plane[vertices]
    sides = np.abs(np.roll(corners, -1, axis=1) - np.roll(corners, 1, axis=1))  # opposite to each corner
    order = np.argsort(sides, axis=1, kind="stable")
    vertices, sides = np.take_along_axis(vertices, order, axis=1), np.take_along_axis(sides, order, axis=1)
    corners = plane[vertices]
    area = ((corners[:, 1] - corners[:, 0]).conj() * (corners[:, 2] - corners[:, 0])).imag
    return Triangles(vertices, sides, (area > 0.0).astype(np.int64))
