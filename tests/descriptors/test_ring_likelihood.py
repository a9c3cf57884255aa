"""Likelihoods of neighbours by class and ring: the formula, and what a query scores by it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from descriptors.baselines.onion import OnionHistogram
from descriptors.constellation import Constellations, gather_constellations
from descriptors.ring_likelihood import CHUNK, RingLikelihood, count_at_a_time
from slam.common.arrays import FloatArray, IntArray
from slam.common.geometry import apply, transform_from_xyz_yaw
from tests.descriptors.constellations import VOCABULARY, constellation, describe, scattered, street, thinned

CLASSES = len(VOCABULARY)
OTHERS = {"radius_m": 24.0, "ring_m": 0.8, "sigmas_m": (0.5, 2.0), "miss_probability": 0.3, "objects_per_km2": 2000.0}


def speaks(
    distances_m: FloatArray,
    ring_m: float,
    *,
    sigmas_m: tuple[float, float] = (0.3, 1.2),
    miss_probability: float = 0.1,
    objects_per_km2: float = 500.0,
) -> tuple[float, float]:
    """What an object in a ring around ``ring_m`` says for one with others of its class (n,), and the odds, in nats.

    The second is what a density of 1 per metre would be multiplied by.
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
    assert described.dtype == np.float32
    shape = {key: value for key, value in settings.items() if key not in ("radius_m", "ring_m")}
    for centre in range(30):
        near = around(positions, labels, centre, descriptor.radius_m)
        for label in range(CLASSES):
            distances_m = np.array([distance_m for other, distance_m in near if other == label])
            for ring in range(rings):
                nats, odds = speaks(distances_m, (ring + 0.5) * ring_m, **shape)
                found = described[centre, label * rings + ring]
                # The kernel ends where each neighbour adds no more than this to the density.
                lost = 2e-5 * odds * len(distances_m)
                assert np.exp(nats) - lost - 1e-3 * np.exp(nats) <= np.exp(found) <= np.exp(nats) * (1.0 + 1e-3)


def test_the_default_is_out_to_60_m_in_half_metres():
    descriptor = RingLikelihood()
    assert (descriptor.name, descriptor.radius_m, descriptor.rings) == ("ring_likelihood", 60.0, 120)


def test_a_neighbour_speaks_most_where_it_stands_and_for_its_class_alone():
    descriptor = RingLikelihood()
    (vector,) = descriptor.describe(constellation([(2, 20.25, 0.7)])).reshape(1, CLASSES, -1)
    assert vector[2].argmax() == 40
    assert (np.diff(vector[2, 30:41]) > 0.0).all()
    assert (np.diff(vector[2, 40:51]) < 0.0).all()
    assert not vector[[0, 1, 3]].any()
    assert not vector[2, :30].any()
    assert not vector[2, 51:].any()


def test_both_parts_of_the_kernel_count_the_narrow_one_for_a_fit_and_the_wide_one_for_the_rest():
    exact, near, noisy, far = RingLikelihood().describe(constellation([(0, 20.25, 0.0)]))[0, [40, 41, 43, 48]]
    assert exact > near + 0.5 > noisy + 1.0
    assert noisy > 1.0
    assert far < 0.5


def test_a_rare_place_says_more_than_one_that_is_full_everywhere():
    """Far rings have more objects by chance; of those that stand near each other, few."""
    descriptor = RingLikelihood()
    at = [descriptor.most_nats(constellation([(0, distance_m, 0.0)]))[0] for distance_m in (2.25, 10.25, 30.25, 59.75)]
    assert (np.diff(at) < -0.5).all()
    dense = RingLikelihood(objects_per_km2=5000.0)
    assert dense.most_nats(constellation([(0, 30.25, 0.0)]))[0] < at[2] - 1.5


def test_more_misses_make_a_neighbour_say_less():
    query = constellation([(0, 30.25, 0.0)])
    said = [
        RingLikelihood(miss_probability=miss_probability).most_nats(query)[0]
        for miss_probability in (0.01, 0.1, 0.5, 0.9)
    ]
    assert (np.diff(said) < -0.5).all()


@pytest.mark.parametrize("yaw_rad", [0.3, np.pi, -2.0])
def test_yaw_and_translation_change_nothing(yaw_rad):
    positions, labels = scattered(60, seed=2)
    moved = apply(transform_from_xyz_yaw(np.array([120.0, -75.0, 4.0]), yaw_rad), positions)
    before, after = (describe(RingLikelihood(), places, labels) for places in (positions, moved))
    assert (np.linalg.norm(after - before, axis=1) / np.linalg.norm(before, axis=1)).max() < 1e-4


def test_the_order_of_the_objects_changes_nothing():
    positions, labels = scattered(60, seed=3)
    order = np.random.default_rng(0).permutation(60)
    before = describe(RingLikelihood(), positions, labels)[order]
    np.testing.assert_allclose(describe(RingLikelihood(), positions[order], labels[order]), before, atol=1e-5)


def test_heights_change_nothing():
    positions, labels = scattered(40, seed=4)
    flat = describe(RingLikelihood(), positions * [1.0, 1.0, 0.0], labels)
    np.testing.assert_array_equal(describe(RingLikelihood(), positions, labels), flat)


def test_a_vocabulary_that_grows_adds_entries_at_the_end_where_nothing_is():
    positions, labels = scattered(40, seed=5)
    before = describe(RingLikelihood(), positions, labels)
    grown = describe(RingLikelihood(), positions, labels, (*VOCABULARY, "fountain", "wall"))
    np.testing.assert_array_equal(grown[:, : before.shape[1]], before)
    assert grown.shape[1] == (CLASSES + 2) * 120
    assert not grown[:, before.shape[1] :].any()


def test_the_classes_have_their_entries_in_the_order_of_the_vocabulary():
    positions, labels = scattered(40, seed=6)
    before = describe(RingLikelihood(), positions, labels).reshape(40, CLASSES, -1)
    backwards = describe(RingLikelihood(), positions, CLASSES - 1 - labels, VOCABULARY[::-1])
    np.testing.assert_array_equal(backwards.reshape(40, CLASSES, -1)[:, ::-1], before)


def test_an_object_without_neighbours_has_a_vector_of_zeros_and_scores_nothing():
    descriptor = RingLikelihood()
    beside = gather_constellations(
        np.array([[0.0, 0.0, 0.0], [500.0, 0.0, 0.0], [510.0, 0.0, 0.0]]), np.zeros(3, int), VOCABULARY, radius_m=60.0
    )
    assert not descriptor.describe(beside)[0].any()
    assert descriptor.describe(beside)[1:].any(axis=1).all()
    assert descriptor.most_nats(beside)[0] == 0.0
    assert (descriptor.most_nats(beside)[1:] > 0.0).all()


@pytest.mark.parametrize("vocabulary", [VOCABULARY, ()])
def test_no_constellation_gives_no_vector(vocabulary):
    descriptor = RingLikelihood()
    nobody = gather_constellations(np.zeros((0, 3)), np.zeros(0, dtype=np.int64), vocabulary, radius_m=60.0)
    assert descriptor.describe(nobody).shape == (0, len(vocabulary) * 120)
    assert descriptor.cells(nobody).shape == descriptor.most_nats(nobody).shape == (0,)


def test_a_constellation_has_one_vector_among_many_and_alone():
    descriptor = RingLikelihood()
    positions, labels = scattered(CHUNK + 90, seed=7, side_m=300.0)
    constellations = gather_constellations(positions, labels, VOCABULARY, radius_m=60.0)
    together = descriptor.describe(constellations)
    for row in (0, CHUNK - 1, CHUNK, CHUNK + 89):
        np.testing.assert_allclose(descriptor.describe(constellations[np.array([row])])[0], together[row], atol=1e-6)


def test_fewer_are_described_at_a_time_where_there_are_many_classes():
    descriptor = RingLikelihood()
    positions, labels = scattered(20, seed=7, side_m=30.0)
    many = [f"class {i}" for i in range(5000)]
    few_classes = gather_constellations(positions, labels, VOCABULARY, radius_m=60.0)
    many_classes = gather_constellations(positions, labels, many, radius_m=60.0)
    assert count_at_a_time(few_classes) == CHUNK
    assert count_at_a_time(many_classes) == 6
    entries = CLASSES * descriptor.rings
    np.testing.assert_array_equal(descriptor.describe(many_classes)[:, :entries], descriptor.describe(few_classes))


def test_cells_are_the_entries_of_the_class_and_the_ring_out_to_the_very_radius():
    query = constellation([(0, 0.0, 0.0), (0, 0.49, 1.0), (1, 0.51, 2.0), (3, 59.99, 3.0), (3, 60.0, 0.0)])
    np.testing.assert_array_equal(RingLikelihood().cells(query), [0, 0, 120 + 1, 3 * 120 + 119, 3 * 120 + 119])


def test_doubles_count_twice_in_the_density():
    once, twice = constellation([(1, 30.25, 0.4)]), constellation([(1, 30.25, 0.4), (1, 30.25, 0.4)])
    single, double = (np.expm1(RingLikelihood().describe(c)[0].astype(np.float64)) for c in (once, twice))
    np.testing.assert_allclose(double, 2.0 * single, rtol=1e-5)


def test_what_a_query_scores_against_itself_is_the_most_if_its_neighbours_are_apart_and_in_the_middle_of_rings():
    descriptor = RingLikelihood()
    apart = [(label, 0.25 + 6.0 * step + 0.5 * label, step + label) for label in range(CLASSES) for step in range(10)]
    query = constellation(apart)
    itself = scores(descriptor, query, descriptor.describe(query))
    np.testing.assert_allclose(itself[0], descriptor.most_nats(query), rtol=1e-4)


def test_what_a_neighbour_off_the_middle_of_its_ring_lacks_is_little():
    descriptor = RingLikelihood()
    for distance_m in np.linspace(20.0, 20.499, 11):
        query = constellation([(0, float(distance_m), 0.0)])
        lacking = descriptor.most_nats(query)[0] - scores(descriptor, query, descriptor.describe(query))[0, 0]
        assert -1e-4 < lacking < 0.3


def test_every_object_of_a_scattered_map_scores_most_against_itself():
    descriptor = RingLikelihood()
    constellations = gather_constellations(*scattered(60, seed=8), VOCABULARY, radius_m=60.0)
    total = scores(descriptor, constellations, descriptor.describe(constellations))
    np.testing.assert_array_equal(total.argmax(axis=1), np.arange(60))


def test_objects_are_found_though_all_are_half_a_metre_off():
    """They fall out of the narrow part of the kernel, but not out of the wide one."""
    descriptor = RingLikelihood()
    positions, labels = scattered(80, seed=9, side_m=150.0)
    noise = np.random.default_rng(10).normal(scale=0.5, size=positions.shape)
    vectors = describe(descriptor, positions, labels)
    noisy = gather_constellations(positions + noise, labels, VOCABULARY, radius_m=60.0)
    total = scores(descriptor, noisy, vectors)
    assert np.mean(total.argmax(axis=1) == np.arange(80)) > 0.95


def found_first(alike: FloatArray, labels: IntArray) -> float:
    """Share of the objects whose own entry is more alike (N, N) than all others of its class."""
    rivals = np.where(labels[:, None] == labels, alike, -np.inf)
    return float(np.mean(np.count_nonzero(rivals >= np.diag(rivals)[:, None], axis=1) == 1))


def likeness(vectors: NDArray[np.float32], entries: NDArray[np.float32]) -> FloatArray:
    """Of vectors by their Euclidean distance, the larger the nearer (Q, M)."""
    return -np.linalg.norm(vectors[:, None].astype(np.float64) - entries, axis=2)


@pytest.fixture(scope="module", params=range(3))
def views(request) -> tuple[Constellations, Constellations, Constellations]:
    """The objects of a street; the same, measured again; and the third of them that one sees looking along it."""
    entries = gather_constellations(*street(120, seed=request.param), VOCABULARY, radius_m=60.0)
    rng = np.random.default_rng(request.param)
    noisy = entries.positions + rng.normal(scale=0.2, size=entries.positions.shape)
    again = replace(entries, positions=noisy)
    ahead = rng.choice([-1.0, 1.0], len(entries))[entries.owners] * noisy[:, 0] > 0.0
    third = thinned(again, ahead & (np.hypot(noisy[:, 0], noisy[:, 1]) < 40.0))
    assert 0.25 < len(third.labels) / len(again.labels) < 0.4
    return entries, again, third


def test_what_a_query_does_not_see_costs_it_nothing(views):
    entries, again, third = views
    descriptor = RingLikelihood()
    vectors = descriptor.describe(entries)
    assert found_first(scores(descriptor, again, vectors), entries.centre_labels) == 1.0
    assert found_first(scores(descriptor, third, vectors), entries.centre_labels) > 0.9


@pytest.mark.slow
@pytest.mark.parametrize("shells", [3, 30])
def test_between_histograms_what_a_query_does_not_see_costs_it_most(views, shells):
    entries, again, third = views
    descriptor = OnionHistogram(radius_m=60.0, shells=shells)
    vectors = descriptor.describe(entries)
    whole, part = (
        found_first(likeness(descriptor.describe(seen), vectors), entries.centre_labels) for seen in (again, third)
    )
    assert whole > 0.75
    assert part < whole - 0.3


def test_a_score_lacks_nothing_to_the_most_whichever_neighbours_are_left_out():
    descriptor = RingLikelihood()
    rng = np.random.default_rng(11)
    middles = [(int(rng.integers(CLASSES)), 0.25 + 0.5 * ring, ring) for ring in rng.permutation(119)[:40].tolist()]
    entry = constellation(middles)
    for share in (0.1, 0.4, 0.8):
        query = thinned(entry, rng.random(40) < share)
        itself = scores(descriptor, query, descriptor.describe(entry))[0, 0]
        # Neighbours of one class in rings side by side add to each other.
        assert descriptor.most_nats(query)[0] - 1e-3 <= itself < 1.2 * descriptor.most_nats(query)[0]
