"""The handcrafted baseline counts what loops over objects count."""

import numpy as np

from descriptors.baselines import BINS, GosmatchVertex
from descriptors.class_vectors import class_vectors
from tests.descriptors.constellations import VOCABULARY, describe, gathered, scattered


def test_gosmatch_vertex_sums_vectors_of_classes_by_distance() -> None:
    positions, labels = scattered(70, seed=2)
    vectors = class_vectors(VOCABULARY, 64)
    apart_m = np.linalg.norm(positions[:, None, :2] - positions[None, :, :2], axis=2)
    expected = np.zeros((70, BINS, 64))
    for centre, other in zip(*np.nonzero(apart_m <= 30.0), strict=True):
        if centre != other:
            expected[centre, int(apart_m[centre, other])] += vectors[labels[other]]
    np.testing.assert_allclose(describe(GosmatchVertex(), positions, labels), expected.reshape(70, -1), atol=1e-5)


def test_last_bin_counts_edges_longer_than_all_bins() -> None:
    positions = np.array([[0.0, 0.0, 0.0], [200.0, 0.0, 0.0]])
    apart = gathered(positions, np.array([0, 1]), 300.0)
    bins = GosmatchVertex().describe(apart).reshape(2, BINS, 64)
    np.testing.assert_allclose(np.linalg.norm(bins, axis=2), np.eye(BINS)[[BINS - 1, BINS - 1]], atol=1e-5)


def test_order_of_the_vocabulary_changes_no_vector() -> None:
    positions, labels = scattered(60, seed=15)
    grown = ("arch", "bench", "fountain", "lamp", "sign", "tree", "wall")
    places = np.array([grown.index(name) for name in VOCABULARY])
    after = describe(GosmatchVertex(), positions, places[labels], grown)
    np.testing.assert_allclose(after, describe(GosmatchVertex(), positions, labels), rtol=1e-4, atol=1e-4)
