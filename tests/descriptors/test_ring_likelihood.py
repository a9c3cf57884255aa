"""Likelihoods of neighbours by class and ring: the formula, and what a query scores by it."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from descriptors.constellation import Constellations, gather_constellations
from descriptors.ring_likelihood import CHUNK, RingLikelihood, count_at_a_time
from slam.common.arrays import FloatArray, IntArray
from tests.descriptors.constellations import VOCABULARY, constellation, describe, scattered, thinned

CLASSES = len(VOCABULARY)


def evidence(distances_m: FloatArray, ring_m: float) -> tuple[float, float]:
    """Nats of an object in a ring around ``ring_m`` for one with others of its class at distances (n,), and the odds
    by which a density of 1 per metre would be multiplied.
    """
    density = 0.5 * sum(stats.norm.pdf(ring_m, distance, sigma) for distance in distances_m for sigma in (0.3, 1.2))
    circle_m2_per_m = np.pi * ((ring_m + 0.5) ** 2 - (ring_m - 0.5) ** 2)
    odds = 9.0 / (500.0 / 1e6 * circle_m2_per_m + 1e-3)
    return float(np.log(1.0 + odds * density)), odds


def around(positions: FloatArray, labels: IntArray, centre: int, radius_m: float) -> list[tuple[int, float]]:
    """Label and distance of all objects but the centre that are within the radius of it."""
    apart_m = np.hypot(*(positions - positions[centre])[:, :2].T).tolist()
    return [(int(labels[o]), apart_m[o]) for o in range(len(labels)) if o != centre and apart_m[o] <= radius_m]


def scores(descriptor: RingLikelihood, queries: Constellations, vectors: NDArray[np.float32]) -> FloatArray:
    """What each query scores against each vector (Q, M), neighbour by neighbour."""
    cells = descriptor.cells(queries)
    total = np.zeros((len(queries), len(vectors)))
    for neighbour, owner in enumerate(queries.owners.tolist()):
        total[owner] += vectors[:, cells[neighbour]]
    return total


def test_entries_are_the_formula_over_the_neighbours_of_each_class():
    descriptor = RingLikelihood()
    positions, labels = scattered(15, seed=1)
    described = describe(descriptor, positions, labels)
    assert described.shape == (15, CLASSES * 120)
    for centre in range(15):
        near = around(positions, labels, centre, descriptor.radius_m)
        for label in range(CLASSES):
            distances_m = np.array([distance_m for other, distance_m in near if other == label])
            for ring in range(120):
                nats, odds = evidence(distances_m, (ring + 0.5) * 0.5)
                found = described[centre, label * 120 + ring]
                # The kernel ends where each neighbour adds no more than this to the density.
                lost = 2e-5 * odds * len(distances_m)
                assert np.exp(nats) - lost - 1e-3 * np.exp(nats) <= np.exp(found) <= np.exp(nats) * (1.0 + 1e-3)


def test_fewer_are_described_at_a_time_where_there_are_many_classes():
    descriptor = RingLikelihood()
    positions, labels = scattered(20, seed=7, side_m=30.0)
    many = [f"class {i}" for i in range(5000)]
    few_classes = gather_constellations(positions, labels, VOCABULARY, radius_m=60.0)
    many_classes = gather_constellations(positions, labels, many, radius_m=60.0)
    assert (count_at_a_time(few_classes), count_at_a_time(many_classes)) == (CHUNK, 6)
    entries = CLASSES * descriptor.rings
    np.testing.assert_array_equal(descriptor.describe(many_classes)[:, :entries], descriptor.describe(few_classes))


def test_cells_are_the_entries_of_the_class_and_the_ring_out_to_the_radius():
    query = constellation([(0, 0.0, 0.0), (0, 0.49, 1.0), (1, 0.51, 2.0), (3, 59.99, 3.0), (3, 60.0, 0.0)])
    np.testing.assert_array_equal(RingLikelihood().cells(query), [0, 0, 120 + 1, 3 * 120 + 119, 3 * 120 + 119])


@pytest.mark.parametrize("share", [1.0, 0.8, 0.4, 0.1])
def test_score_against_itself_is_the_most_for_any_neighbours_that_are_seen(share):
    descriptor = RingLikelihood()
    middles = [(label, 0.25 + 6.0 * step + 0.5 * label, step + label) for label in range(CLASSES) for step in range(10)]
    entry = constellation(middles)
    query = thinned(entry, np.random.default_rng(11).random(len(middles)) < share)
    itself = scores(descriptor, query, descriptor.describe(entry))
    np.testing.assert_allclose(itself[0], descriptor.max_nats(query), rtol=1e-4)
