"""The handcrafted baselines count what loops over objects count."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from numpy.typing import NDArray

from descriptors.baselines.gosmatch import BINS, GosmatchGraph, GosmatchVertex
from descriptors.baselines.onion import Onion, OnionHistogram
from descriptors.baselines.random_walk import RandomWalk
from descriptors.class_vectors import class_vectors
from descriptors.descriptor import Descriptor
from slam.common.arrays import FloatArray
from tests.descriptors.constellations import VOCABULARY, describe, scattered

BASELINES: tuple[Descriptor, ...] = (Onion(), OnionHistogram(), RandomWalk(), GosmatchVertex(), GosmatchGraph())
every_baseline = pytest.mark.parametrize("descriptor", BASELINES, ids=lambda d: d.name)


def around(positions: FloatArray, centre: int, radius_m: float = 30.0) -> list[int]:
    """All objects but the centre that are within the radius of it, the nearest first."""
    apart_m = np.hypot(*(positions - positions[centre])[:, :2].T)
    return [other for other in np.argsort(apart_m).tolist() if other != centre and apart_m[other] <= radius_m]


def apart_m(positions: FloatArray, a: int, b: int) -> float:
    return float(np.hypot(*(positions[a] - positions[b])[:2]))


def test_onion_counts_the_objects_within_ten_twenty_and_thirty_metres():
    positions, labels = scattered(70, seed=1)
    expected = np.zeros((70, 3))
    for centre in range(70):
        for other in around(positions, centre):
            expected[centre, int(apart_m(positions, centre, other) // 10.0)] += 1
    np.testing.assert_array_equal(describe(Onion(), positions, labels), expected)


@pytest.mark.parametrize(("descriptor", "bins", "width_m"), [(OnionHistogram(), 3, 10.0), (GosmatchVertex(), 61, 1.0)])
def test_onion_histogram_and_gosmatch_vertex_sum_the_vectors_of_the_classes_by_distance(descriptor, bins, width_m):
    positions, labels = scattered(70, seed=2)
    vectors = class_vectors(VOCABULARY, 64)
    expected = np.zeros((70, bins, 64))
    for centre in range(70):
        for other in around(positions, centre):
            expected[centre, int(apart_m(positions, centre, other) // width_m)] += vectors[labels[other]]
    np.testing.assert_allclose(describe(descriptor, positions, labels), expected.reshape(70, -1), atol=1e-5)


def vector_of_pair(a: int, b: int) -> NDArray[np.float32]:
    """What one edge adds to its bin (64,), seen on two objects that are half a metre apart."""
    alone = describe(GosmatchGraph(), np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0]]), np.array([a, b]))
    return alone.reshape(2, BINS, 64)[0, 0]


def test_gosmatch_graph_sums_the_vectors_of_the_pairs_of_classes_of_all_edges_by_their_length():
    positions, labels = scattered(50, seed=3)
    vectors = np.array([[vector_of_pair(a, b) for b in range(4)] for a in range(4)])
    np.testing.assert_array_equal(vectors, vectors.transpose(1, 0, 2))
    products = vectors[np.triu_indices(4)] @ vectors[np.triu_indices(4)].T
    np.testing.assert_allclose(np.diag(products), 1.0, atol=1e-5)
    assert np.abs(products - np.diag(np.diag(products))).max() < 0.5
    expected = np.zeros((50, BINS, 64))
    for centre in range(50):
        objects = [centre, *around(positions, centre)]
        for i, first in enumerate(objects):
            for second in objects[:i]:
                edge = vectors[int(labels[first]), int(labels[second])]
                expected[centre, int(apart_m(positions, first, second) // 1.0)] += edge
    np.testing.assert_allclose(describe(GosmatchGraph(), positions, labels), expected.reshape(50, -1), atol=1e-4)


def test_last_bin_counts_the_edges_that_are_longer_than_all_bins():
    positions = np.array([[0.0, 0.0, 0.0], [200.0, 0.0, 0.0]])
    for descriptor in (GosmatchVertex(radius_m=300.0), GosmatchGraph(radius_m=300.0)):
        bins = describe(descriptor, positions, np.array([0, 1])).reshape(2, BINS, 64)
        np.testing.assert_allclose(np.linalg.norm(bins, axis=2), np.eye(BINS)[[BINS - 1, BINS - 1]], atol=1e-5)


def walks_by_loop(positions: FloatArray, objects: list[int], draws: FloatArray) -> list[tuple[int, ...]]:
    """The objects on each walk from the first of them on: the others are the ways, the nearest to the first ahead."""
    apart = {(a, b): apart_m(positions, a, b) for a in objects for b in objects if a != b}
    mean_m = np.mean(list(apart.values())) if apart else 0.0
    walks = []
    for walker in range(draws.shape[1]):
        visited = [objects[0]]
        for draw in draws[:, walker]:
            here = visited[-1]
            ways = [o for o in objects if o != here and apart[here, o] <= mean_m + 1e-6]
            onward = [o for o in ways if len(visited) < 2 or o != visited[-2]] or ways
            visited.append(onward[int(draw * len(onward))] if onward else here)
        walks.append(tuple(visited))
    return walks


def test_vectors_of_random_walks_multiply_to_the_number_of_equal_walks():
    positions, labels = scattered(40, seed=4)
    # So long that no two of the sequences of four classes share a column.
    vectors = describe(RandomWalk(length=1 << 18), positions, labels)
    vectors = vectors[:, vectors.any(axis=0)]
    draws = np.random.default_rng(0).random((3, 30))
    walked = [walks_by_loop(positions, [centre, *around(positions, centre)], draws) for centre in range(40)]
    counts = [Counter(tuple(labels[list(visited)].tolist()) for visited in walks) for walks in walked]
    equal = [[sum(a[sequence] * b[sequence] for sequence in a) for b in counts] for a in counts]
    assert len(set().union(*counts)) > 100
    np.testing.assert_allclose(vectors @ vectors.T, equal, atol=1e-3)


def test_walks_do_not_depend_on_the_order_or_rounding_of_equal_distances():
    rng = np.random.default_rng(13)
    angles, distances_m = rng.uniform(0.0, 2.0 * np.pi, 30), 10.0 + 1e-5 * np.arange(30)
    ring = np.column_stack([distances_m * np.cos(angles), distances_m * np.sin(angles), np.zeros(30)])
    # The ring is of one class; the objects that tell its members apart are outside.
    outside, outside_labels = scattered(20, seed=14, side_m=25.0)
    positions = np.concatenate([np.zeros((1, 3)), ring, outside])
    labels = np.concatenate([np.zeros(31, dtype=np.int64), outside_labels])
    order = np.concatenate([[0], 1 + rng.permutation(50)])
    listed, shuffled = (describe(RandomWalk(), positions[o], labels[o])[0] for o in (np.arange(51), order))
    np.testing.assert_array_equal(listed, shuffled)
    bearings = rng.uniform(0.0, 2.0 * np.pi, 4) + np.linspace(0.0, 6.0, 40)[:, None]
    turned = np.zeros((40, 5, 3))
    turned[:, 1:, :2] = 13.7 * np.stack([np.cos(bearings), np.sin(bearings)], axis=2)
    vectors = [describe(RandomWalk(), each, np.array([0, 0, 1, 2, 3]))[0] for each in turned]
    np.testing.assert_array_equal(vectors, vectors[:1] * 40)


@every_baseline
def test_heights_and_the_order_of_the_vocabulary_change_nothing(descriptor):
    positions, labels = scattered(60, seed=15)
    lifted = positions + np.random.default_rng(18).uniform(0.0, 20.0, (60, 1)) * [0.0, 0.0, 1.0]
    before = describe(descriptor, positions, labels)
    grown = ("arch", "bench", "fountain", "lamp", "sign", "tree", "wall")
    places = np.array([grown.index(name) for name in VOCABULARY])
    for after in (describe(descriptor, lifted, labels), describe(descriptor, positions, places[labels], grown)):
        np.testing.assert_allclose(after, before, rtol=1e-4, atol=1e-4)
    assert descriptor.radius_m == 30.0  # as in the paper


@every_baseline
def test_all_but_the_onion_distinguish_classes(descriptor):
    positions, labels = scattered(40, seed=16)
    before, after = describe(descriptor, positions, labels), describe(descriptor, positions, (labels + 1) % 4)
    change = (np.linalg.norm(after - before, axis=1) / np.linalg.norm(before, axis=1)).min()
    assert change == 0.0 if descriptor.name == "onion" else change > 0.5
