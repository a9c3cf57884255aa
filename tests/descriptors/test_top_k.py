"""How often views of one thing are each other's nearest: as a loop counts."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from descriptors.training.top_k import CHUNK, top_k_ratio


def counted(vectors: NDArray[np.float32], things: NDArray[np.int64], k: int) -> float:
    """The ratio, one vector after the other."""
    hits = 0
    for row, vector in enumerate(vectors):
        distances = np.linalg.norm(vectors.astype(np.float64) - vector, axis=1)
        nearest = [other for other in np.argsort(distances) if other != row][:k]
        hits += any(things[other] == things[row] for other in nearest)
    return hits / len(vectors)


@pytest.mark.parametrize(("things", "k"), [(30, 1), (30, 5), (CHUNK // 3, 2), (CHUNK // 2, 2)])
def test_ratio_is_what_a_loop_counts_in_one_chunk_and_in_several(things, k):
    rng = np.random.default_rng(things)
    numbers = rng.permutation(np.repeat(np.arange(things), 3))
    vectors = (rng.normal(size=(things, 6))[numbers] + 0.6 * rng.normal(size=(len(numbers), 6))).astype(np.float32)
    ratio = top_k_ratio(vectors, numbers, k)
    assert 0.0 < ratio < 1.0
    assert ratio == counted(vectors, numbers, k)


def test_all_neighbours_find_everything_and_fewer_than_two_vectors_have_no_ratio():
    assert top_k_ratio(np.eye(40, dtype=np.float32), np.arange(40) // 2, 1000) == 1.0
    assert np.isnan(top_k_ratio(np.zeros((1, 3), np.float32), np.arange(1), 5))
