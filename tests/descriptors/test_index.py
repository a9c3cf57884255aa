"""The index of vectors finds what brute force finds."""

import numpy as np
import pytest
from numpy.typing import NDArray

from descriptors.constellation import Constellations
from descriptors.index import Matches, VectorIndex

LENGTH = 6


class Prepared:
    """The vector of a constellation of two neighbours is their positions, so that a test can choose it."""

    name = "prepared"
    radius_m = 17.0

    def describe(self, constellations: Constellations) -> NDArray[np.float32]:
        return constellations.positions.reshape(len(constellations), LENGTH).astype(np.float32)


def prepared(vectors: NDArray[np.float32], labels: NDArray[np.int64]) -> Constellations:
    """Constellations that have these vectors (B, LENGTH)."""
    offsets = 2 * np.arange(len(vectors) + 1)
    positions = vectors.astype(np.float64).reshape(-1, 3)
    zeros = np.zeros(len(positions), int)
    return Constellations(positions, zeros, labels, offsets, ("a", "b", "c"))


def alike(vector: float, count: int) -> Constellations:
    """So many constellations of class 0, with all numbers of their vectors the same."""
    return prepared(np.full((count, LENGTH), vector, dtype=np.float32), np.zeros(count, int))


def filled(count: int) -> tuple[VectorIndex, NDArray[np.float32], NDArray[np.int64]]:
    """An index with its vectors and labels, entered in several parts."""
    rng = np.random.default_rng(0)
    vectors = rng.normal(size=(count, LENGTH)).astype(np.float32)
    labels = rng.integers(3, size=count)
    index = VectorIndex(Prepared())
    for part in np.array_split(np.arange(count), 4):
        index.add(prepared(vectors[part], labels[part]))
    assert len(index) == count
    return index, vectors, labels


def entries_of(matches: Matches, query: int) -> list[int]:
    return [int(entry) for entry in matches.entries[matches.queries == query]]


@pytest.mark.parametrize("k", [1, 20, 1000])
def test_the_nearest_of_the_own_class_among_the_allowed_are_found_in_order(k):
    count = 700
    index, vectors, labels = filled(count)
    rng = np.random.default_rng(1)
    queries = rng.normal(size=(25, LENGTH)).astype(np.float32)
    query_labels = rng.integers(3, size=25)
    allowed = rng.random(count) < 0.6
    matches = index.search(prepared(queries, query_labels), k, allowed)
    assert np.all(np.diff(matches.queries) >= 0)
    for query in range(25):
        distances = np.linalg.norm(vectors - queries[query], axis=1)
        candidates = np.flatnonzero(allowed & (labels == query_labels[query]))
        expected = candidates[np.argsort(distances[candidates], kind="stable")][:k]
        assert entries_of(matches, query) == expected.tolist()


def test_ties_go_to_the_lower_number():
    """Objects without neighbours all have the same vector, so that ties are common."""
    index = VectorIndex(Prepared())
    index.add(alike(0.0, 200))
    index.add(alike(1.0, 1))
    matches = index.search(alike(1.0, 2), 6, np.ones(201, bool))
    assert entries_of(matches, 0) == entries_of(matches, 1) == [200, 0, 1, 2, 3, 4]


@pytest.mark.parametrize(("entries", "queries", "allowed"), [(0, 3, True), (20, 0, True), (20, 3, False)])
def test_nothing_is_found_in_an_empty_index_for_no_query_or_among_none_allowed(entries, queries, allowed):
    index = VectorIndex(Prepared())
    index.add(alike(0.0, entries))
    matches = index.search(alike(0.0, queries), 4, np.full(entries, allowed))
    assert len(matches.queries) == len(matches.entries) == 0
