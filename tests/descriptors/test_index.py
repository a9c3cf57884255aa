"""The index of descriptors finds what brute force finds."""

from __future__ import annotations

import numpy as np
import pytest

from descriptors.index import DescriptorIndex, Matches

LENGTH = 6


def filled(count: int, *, seed: int, classes: int = 3) -> tuple[DescriptorIndex, np.ndarray, np.ndarray]:
    """An index with its vectors and labels, entered in several parts."""
    rng = np.random.default_rng(seed)
    vectors = rng.normal(size=(count, LENGTH)).astype(np.float32)
    labels = rng.integers(classes, size=count)
    index = DescriptorIndex(LENGTH)
    for part in np.array_split(np.arange(count), 4):
        np.testing.assert_array_equal(index.add(vectors[part], labels[part]), part)
    assert len(index) == count
    return index, vectors, labels


def entries_of(matches: Matches, query: int) -> list[int]:
    return [int(entry) for entry in matches.entries[matches.queries == query]]


@pytest.mark.parametrize(("count", "k"), [(700, 5), (40, 1), (300, 20)])
def test_the_nearest_of_the_own_class_among_the_allowed_are_found_in_order(count, k):
    index, vectors, labels = filled(count, seed=count)
    rng = np.random.default_rng(1)
    queries = rng.normal(size=(25, LENGTH)).astype(np.float32)
    query_labels = rng.integers(3, size=25)
    allowed = rng.random(count) < 0.6
    matches = index.search(queries, query_labels, k, allowed)
    assert np.all(np.diff(matches.queries) >= 0)
    for query in range(25):
        distances = np.linalg.norm(vectors - queries[query], axis=1)
        candidates = np.flatnonzero(allowed & (labels == query_labels[query]))
        expected = candidates[np.argsort(distances[candidates], kind="stable")][:k]
        assert entries_of(matches, query) == expected.tolist()
        np.testing.assert_allclose(matches.distances[matches.queries == query], distances[expected], rtol=1e-4)


def test_ties_go_to_the_lower_number():
    """Objects without neighbours all have the same vector, so that ties are common."""
    index = DescriptorIndex(LENGTH)
    index.add(np.zeros((200, LENGTH), dtype=np.float32), np.zeros(200, dtype=np.int64))
    matches = index.search(np.ones((2, LENGTH), dtype=np.float32), np.zeros(2, dtype=np.int64), 6, np.ones(200, bool))
    assert entries_of(matches, 0) == entries_of(matches, 1) == [0, 1, 2, 3, 4, 5]


def test_ties_behind_a_nearer_entry_go_to_the_lower_number():
    index = DescriptorIndex(LENGTH)
    vectors = np.zeros((100, LENGTH), dtype=np.float32)
    vectors[60] = 1.0
    index.add(vectors, np.zeros(100, dtype=np.int64))
    matches = index.search(np.ones((1, LENGTH), dtype=np.float32), np.zeros(1, dtype=np.int64), 3, np.ones(100, bool))
    assert entries_of(matches, 0) == [60, 0, 1]


def test_fewer_than_asked_for_are_all_found_and_nothing_else():
    index, _, labels = filled(30, seed=2)
    allowed = np.zeros(30, dtype=bool)
    allowed[np.flatnonzero(labels == 1)[:2]] = True
    allowed[np.flatnonzero(labels == 0)[:5]] = True
    queries = np.zeros((2, LENGTH), dtype=np.float32)
    matches = index.search(queries, np.array([1, 2]), 10, allowed)
    np.testing.assert_array_equal(matches.queries, [0, 0])
    assert sorted(entries_of(matches, 0)) == np.flatnonzero(labels == 1)[:2].tolist()


def test_an_entry_is_at_no_distance_from_itself():
    index, vectors, labels = filled(50, seed=3)
    matches = index.search(vectors, labels, 1, np.ones(50, dtype=bool))
    np.testing.assert_array_equal(matches.entries, np.arange(50))
    # Squares of float32 vectors of length 2.4 cancel to about 1e-6.
    np.testing.assert_allclose(matches.distances, 0.0, atol=3e-3)


@pytest.mark.parametrize(("entries", "queries", "allowed"), [(0, 3, True), (20, 0, True), (20, 3, False)])
def test_nothing_is_found_in_an_empty_index_for_no_query_or_among_none_allowed(entries, queries, allowed):
    index = DescriptorIndex(LENGTH)
    index.add(np.zeros((entries, LENGTH), dtype=np.float32), np.zeros(entries, dtype=np.int64))
    vectors, labels = np.zeros((queries, LENGTH), dtype=np.float32), np.zeros(queries, dtype=np.int64)
    matches = index.search(vectors, labels, 4, np.full(entries, allowed))
    assert len(matches.queries) == len(matches.entries) == len(matches.distances) == 0
