"""Scattered objects for the tests of descriptors."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from descriptors.constellation import Constellations, gather_constellations
from descriptors.descriptellation_lr.pair_index import PairIndex
from descriptors.descriptor import Descriptor
from descriptors.index import Matches, VectorIndex
from slam.common.arrays import FloatArray, IntArray

VOCABULARY = ("bench", "lamp", "sign", "tree")


def scattered(count: int, *, seed: int, side_m: float = 60.0) -> tuple[FloatArray, IntArray]:
    """Positions (N, 3) m in a square, and labels (N,)."""
    rng = np.random.default_rng(seed)
    positions = np.column_stack([rng.uniform(0.0, side_m, (count, 2)), rng.uniform(-1.0, 3.0, count)])
    return positions, rng.integers(len(VOCABULARY), size=count)


def gathered(
    positions: FloatArray, labels: IntArray, radius_m: float, centres: IntArray | None = None
) -> Constellations:
    """With the labels of ``VOCABULARY``."""
    return gather_constellations(positions, labels, VOCABULARY, radius_m=radius_m, centres=centres)


def found_again(index: VectorIndex | PairIndex, positions: FloatArray, labels: IntArray, k: int = 1) -> Matches:
    """What an index of objects, empty before, finds when it is asked for all of them."""
    assert isinstance(index, VectorIndex)
    constellations = gathered(positions, labels, index.radius_m)
    index.add(constellations)
    return index.search(constellations, k, np.ones(len(labels), bool))


def describe(
    descriptor: Descriptor, positions: FloatArray, labels: IntArray, vocabulary: Sequence[str] = VOCABULARY
) -> NDArray[np.float32]:
    """The descriptor (N, D) of each object among all the others."""
    return descriptor.describe(gather_constellations(positions, labels, vocabulary, radius_m=descriptor.radius_m))
