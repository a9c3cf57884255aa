"""Likelihoods of neighbours by class and ring: the formula, and what a query scores by it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from descriptors.constellation import Constellations, gather_constellations
from descriptors.ring_likelihood import CHUNK, RingLikelihood, count_at_a_time
from slam.common.arrays import FloatArray, IntArray
from tests.descriptors.constellations import VOCABULARY, constellation, describe, scattered, street, thinned

CLASSES = len(VOCABULARY)
OTHERS = {"radius_m": 24.0, "ring_m": 0.8, "sigmas_m": (0.5, 2.0), "miss_probability": 0.3, "objects_per_km2": 2000.0}


def evidence(
    distances_m: FloatArray,
    ring_m: float,
    *,
    sigmas_m: tuple[float, float] = (0.3, 1.2),
    miss_probability: float = 0.1,
    objects_per_km2: float = 500.0,
) -> tuple[float, float]:
    """Nats of an object in a ring around ``ring_m`` for one with others of its class at distances (n,), and the odds
    by which a density of 1 per metre would be multiplied.
    """
    density = 0.0
    for distance_m in distances_m:
        for sigma_m in sigmas_m:
            gauss = np.exp(-((ring_m - distance_m) ** 2) / (2.0 * sigma_m**2)) / np.sqrt(2.0 * np.pi * sigma_m**2)
            density += 0.5 * gauss
    circle_m2_per_m = np.pi * ((ring_m + 0.5) ** 2 - (ring_m - 0.5) ** 2)
    average = objects_per_km2 / 1e6 * circle_m2_per_m + 1e-3
    odds = (1.0 - miss_probability) / miss_probability / average
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


@pytest.mark.parametrize(("settings", "rings", "ring_m"), [({}, 120, 0.5), (OTHERS, 30, 0.8)])
def test_entries_are_the_formula_over_the_neighbours_of_each_class(settings, rings, ring_m):
    descriptor = RingLikelihood(**settings)
    positions, labels = scattered(30, seed=1)
    described = describe(descriptor, positions, labels)
    assert described.shape == (30, CLASSES * rings)
    shape = {key: value for key, value in settings.items() if key not in ("radius_m", "ring_m")}
    for centre in range(30):
        near = around(positions, labels, centre, descriptor.radius_m)
        for label in range(CLASSES):
            distances_m = np.array([distance_m for other, distance_m in near if other == label])
            for ring in range(rings):
                nats, odds = evidence(distances_m, (ring + 0.5) * ring_m, **shape)
                found = described[centre, label * rings + ring]
                # The kernel ends where each neighbour adds no more than this to the density.
                lost = 2e-5 * odds * len(distances_m)
                assert np.exp(nats) - lost - 1e-3 * np.exp(nats) <= np.exp(found) <= np.exp(nats) * (1.0 + 1e-3)


def test_neighbour_is_most_evidence_where_it_stands_and_for_its_class_alone():
    (vector,) = RingLikelihood().describe(constellation([(2, 20.25, 0.7)])).reshape(1, CLASSES, -1)
    assert vector[2].argmax() == 40
    assert (np.diff(vector[2, 30:41]) > 0.0).all()
    assert (np.diff(vector[2, 40:51]) < 0.0).all()
    assert not vector[[0, 1, 3]].any()
    exact, near, noisy, far = vector[2, [40, 41, 43, 48]]
    assert exact > near + 0.5 > noisy + 1.0 > 2.0
    assert far < 0.5


def test_far_rings_dense_maps_and_misses_weaken_the_evidence():
    at = [RingLikelihood().max_nats(constellation([(0, d, 0.0)]))[0] for d in (2.25, 10.25, 30.25, 59.75)]
    assert (np.diff(at) < -0.5).all()
    query = constellation([(0, 30.25, 0.0)])
    assert RingLikelihood(objects_per_km2=5000.0).max_nats(query)[0] < at[2] - 1.5
    said = [RingLikelihood(miss_probability=miss).max_nats(query)[0] for miss in (0.01, 0.1, 0.5, 0.9)]
    assert (np.diff(said) < -0.5).all()


def test_heights_change_nothing_and_doubles_count_twice_in_the_density():
    positions, labels = scattered(40, seed=4)
    flat = describe(RingLikelihood(), positions * [1.0, 1.0, 0.0], labels)
    np.testing.assert_array_equal(describe(RingLikelihood(), positions, labels), flat)
    once, twice = constellation([(1, 30.25, 0.4)]), constellation([(1, 30.25, 0.4), (1, 30.25, 0.4)])
    single, double = (np.expm1(RingLikelihood().describe(c)[0].astype(np.float64)) for c in (once, twice))
    np.testing.assert_allclose(double, 2.0 * single, rtol=1e-5)


def test_object_without_neighbours_has_zeros_and_scores_nothing():
    beside = gather_constellations(
        np.array([[0.0, 0.0, 0.0], [500.0, 0.0, 0.0], [510.0, 0.0, 0.0]]), np.zeros(3, int), VOCABULARY, radius_m=60.0
    )
    vectors, most = RingLikelihood().describe(beside), RingLikelihood().max_nats(beside)
    assert vectors.any(axis=1).tolist() == [False, True, True]
    assert (most > 0.0).tolist() == [False, True, True]


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


def test_neighbour_off_the_middle_of_its_ring_lacks_little():
    descriptor = RingLikelihood()
    for distance_m in np.linspace(20.0, 20.499, 11):
        query = constellation([(0, float(distance_m), 0.0)])
        lacking = descriptor.max_nats(query)[0] - scores(descriptor, query, descriptor.describe(query))[0, 0]
        assert -1e-4 < lacking < 0.3


@pytest.mark.parametrize("seed", range(3))
def test_objects_are_found_with_noise_and_with_a_third_of_their_neighbours(seed):
    """What a query does not see costs it nothing; noise is within the wide part of the kernel."""
    descriptor = RingLikelihood()
    entries = gather_constellations(*street(120, seed=seed), VOCABULARY, radius_m=60.0)
    rng = np.random.default_rng(seed)
    noisy = entries.positions + rng.normal(scale=0.2, size=entries.positions.shape)
    again = replace(entries, positions=noisy)
    ahead = rng.choice([-1.0, 1.0], len(entries))[entries.owners] * noisy[:, 0] > 0.0
    third = thinned(again, ahead & (np.hypot(noisy[:, 0], noisy[:, 1]) < 40.0))
    labels, vectors = entries.centre_labels, descriptor.describe(entries)
    for queries, share in ((again, 1.0), (third, 0.9)):
        rivals = np.where(labels[:, None] == labels, scores(descriptor, queries, vectors), -np.inf)
        is_first = np.count_nonzero(rivals >= np.diag(rivals)[:, None], axis=1) == 1
        assert is_first.mean() >= share
