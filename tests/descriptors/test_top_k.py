"""How often views of one thing are each other's nearest: as counted one by one, and where the answer is plain."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from descriptors.top_k import CHUNK, top_k_ratio


def counted(vectors: NDArray[np.float32], things: NDArray[np.int64], k: int) -> float:
    """The ratio, one vector after the other."""
    hits = 0
    for row, vector in enumerate(vectors):
        distances = np.linalg.norm(vectors.astype(np.float64) - vector, axis=1)
        nearest = [other for other in np.argsort(distances) if other != row][:k]
        hits += any(things[other] == things[row] for other in nearest)
    return hits / len(vectors)


def noisy_views(
    things: int, views: int, *, seed: int, noise: float = 0.8, length: int = 6
) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    rng = np.random.default_rng(seed)
    numbers = rng.permutation(np.repeat(np.arange(things), views))
    places = rng.normal(size=(things, length))[numbers]
    return (places + noise * rng.normal(size=places.shape)).astype(np.float32), numbers


@pytest.mark.parametrize("k", [1, 3, 5])
@pytest.mark.parametrize("seed", range(3))
def test_it_is_what_a_loop_counts(seed, k):
    vectors, things = noisy_views(30, 4, seed=seed)
    ratio = top_k_ratio(vectors, things, k)
    assert 0.0 < ratio < 1.0
    assert ratio == counted(vectors, things, k)


@pytest.mark.parametrize("count", [CHUNK - 1, CHUNK, CHUNK + 1, 2 * CHUNK + 300])
def test_it_is_what_a_loop_counts_across_the_borders_of_chunks(count):
    vectors, things = noisy_views(-(-count // 3), 3, seed=4, noise=0.3)
    assert top_k_ratio(vectors[:count], things[:count], 2) == counted(vectors[:count], things[:count], 2)


def test_views_that_coincide_are_always_found():
    places = np.random.default_rng(5).normal(size=(500, 8)).astype(np.float32)
    assert top_k_ratio(np.repeat(places, 3, axis=0), np.repeat(np.arange(500), 3), 1) == 1.0


def test_things_that_were_seen_once_are_never_found_a_vector_being_no_neighbour_of_its_own():
    vectors = np.random.default_rng(6).normal(size=(CHUNK + 50, 8)).astype(np.float32)
    assert top_k_ratio(vectors, np.arange(CHUNK + 50), 5) == 0.0


def test_views_at_opposite_ends_are_never_found():
    ends = np.where(np.arange(40) < 20, -100.0, 100.0)
    vectors = np.column_stack([ends, np.arange(40) % 20]).astype(np.float32)
    assert top_k_ratio(vectors, np.arange(40) % 20, 5) == 0.0
    assert top_k_ratio(vectors, np.arange(40) % 20, 20) > 0.0


def test_more_neighbours_never_find_less_and_all_of_them_find_everything():
    vectors, things = noisy_views(20, 2, seed=7, noise=3.0)
    ratios = [top_k_ratio(vectors, things, k) for k in (1, 2, 5, 10, 39, 1000)]
    assert ratios == sorted(ratios)
    assert ratios[0] < ratios[-1] == 1.0


def test_vectors_that_say_nothing_find_as_many_as_chance_does():
    rng = np.random.default_rng(8)
    vectors, things = rng.normal(size=(2000, 8)).astype(np.float32), np.repeat(np.arange(200), 10)
    chance = 1.0 - np.prod([(1990 - i) / (1999 - i) for i in range(5)])
    assert top_k_ratio(vectors, things, 5) == pytest.approx(chance, abs=0.015)


@pytest.mark.parametrize("count", [0, 1])
def test_fewer_than_two_vectors_have_no_ratio(count):
    assert np.isnan(top_k_ratio(np.zeros((count, 3), np.float32), np.arange(count), 5))
