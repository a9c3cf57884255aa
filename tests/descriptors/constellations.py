"""Scattered objects for the tests of descriptors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from descriptors.constellation import Constellations, gather_constellations
from descriptors.descriptor import Descriptor
from slam.common.arrays import FloatArray, IntArray

VOCABULARY = ("bench", "lamp", "sign", "tree")


def scattered(count: int, *, seed: int, side_m: float = 60.0) -> tuple[FloatArray, IntArray]:
    """Positions (N, 3) m in a square, and labels (N,)."""
    rng = np.random.default_rng(seed)
    positions = np.column_stack([rng.uniform(0.0, side_m, (count, 2)), rng.uniform(-1.0, 3.0, count)])
    return positions, rng.integers(len(VOCABULARY), size=count)


def street(count: int, *, seed: int, spacing_m: float = 4.0) -> tuple[FloatArray, IntArray]:
    """Positions (N, 3) m along both sides of a straight street, and labels (N,); half of the objects are trees."""
    rng = np.random.default_rng(seed)
    along_m = spacing_m * np.arange(count) + rng.uniform(-0.5, 0.5, count) * spacing_m
    across_m = rng.choice([-1.0, 1.0], count) * rng.uniform(5.0, 8.0, count)
    labels = rng.choice(len(VOCABULARY), count, p=[0.1, 0.25, 0.15, 0.5])
    return np.column_stack([along_m, across_m, rng.uniform(0.0, 3.0, count)]), labels


def describe(
    descriptor: Descriptor, positions: FloatArray, labels: IntArray, vocabulary: Sequence[str] = VOCABULARY
) -> NDArray[np.float32]:
    """The descriptor (N, D) of each object among all the others."""
    return descriptor.describe(gather_constellations(positions, labels, vocabulary, radius_m=descriptor.radius_m))


def constellation(
    neighbours: Sequence[tuple[int, float, float]], *, centre_label: int = 0, vocabulary: Sequence[str] = VOCABULARY
) -> Constellations:
    """One object with its neighbours, each with its label, distance (m) and bearing (rad)."""
    labels, distances_m, bearings_rad = np.array(neighbours, dtype=np.float64).reshape(-1, 3).T
    positions = np.column_stack([distances_m * np.cos(bearings_rad), distances_m * np.sin(bearings_rad), 0.0 * labels])
    offsets, centre = np.array([0, len(labels)]), np.array([centre_label])
    return Constellations(positions, labels.astype(np.int64), centre, offsets, tuple(vocabulary), np.zeros((1, 3)))
