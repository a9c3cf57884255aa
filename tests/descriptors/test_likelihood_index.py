"""The index of likelihoods finds the entries that brute force finds likeliest, to the step that it counts in."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from descriptors.constellation import Constellations, gather_constellations
from descriptors.index import ConstellationIndex, Matches
from descriptors.likelihood_index import CHUNK, STEP_NATS, LikelihoodIndex, count_at_a_time
from slam.common.arrays import FloatArray
from tests.descriptors.constellations import VOCABULARY, constellation, scattered, thinned

RADIUS_M = 60.0
EVERYTHING = 1e6
"""A window that nothing falls out of."""


class RingLikelihood:
    """Neighbours counted by class and ring of half a metre, as nats."""

    radius_m = near_m = RADIUS_M
    min_nats = 0.0

    def __init__(self, odds: float = 50.0) -> None:
        self._odds = odds

    def describe(self, constellations: Constellations) -> NDArray[np.float32]:
        size = 120 * len(constellations.vocabulary)
        cells = constellations.owners * size + self.cells(constellations)
        counts = np.bincount(cells, minlength=size * len(constellations)).reshape(-1, size)
        return np.log1p(self._odds * counts).astype(np.float32)

    def cells(self, constellations: Constellations) -> NDArray[np.int64]:
        distances_m = np.hypot(constellations.positions[:, 0], constellations.positions[:, 1])
        return constellations.labels * 120 + np.minimum(2.0 * distances_m, 119.0).astype(np.int64)

    def max_nats(self, constellations: Constellations) -> NDArray[np.float32]:
        return (8.0 * np.diff(constellations.offsets)).astype(np.float32)


def gathered(count: int, *, seed: int, side_m: float = 80.0, noise_m: float = 0.0) -> Constellations:
    """Those of a scattered map; ``noise_m`` moves each object, but not the map."""
    positions, labels = scattered(count, seed=seed, side_m=side_m)
    noise = np.random.default_rng(seed + 1000).normal(size=positions.shape)
    return gather_constellations(positions + noise_m * noise, labels, VOCABULARY, radius_m=RADIUS_M)


def filled(entries: Constellations, *, window_nats: float = EVERYTHING) -> LikelihoodIndex:
    index = LikelihoodIndex(RingLikelihood(), window_nats=window_nats)
    np.testing.assert_array_equal(index.add(entries), np.arange(len(entries)))
    return index


def everyone(index: ConstellationIndex) -> NDArray[np.bool_]:
    return np.ones(len(index), dtype=bool)


def scores(entries: Constellations, queries: Constellations, *, in_steps: bool) -> FloatArray:
    """What each query scores against each entry (Q, M), in nats or in steps of a byte; -inf for other classes."""
    descriptor = RingLikelihood()
    vectors = descriptor.describe(entries).astype(np.float64)
    if in_steps:
        vectors = np.minimum(np.rint(vectors / STEP_NATS), 255.0)
    cells = descriptor.cells(queries)
    total = np.zeros((len(queries), len(entries)))
    for query in range(len(queries)):
        for cell in cells[queries.offsets[query] : queries.offsets[query + 1]]:
            total[query] += vectors[:, cell]
    total[queries.centre_labels[:, None] != entries.centre_labels] = -np.inf
    return total


def pairs(matches: Matches) -> list[tuple[int, int]]:
    return list(zip(matches.queries.tolist(), matches.entries.tolist(), strict=True))


def assert_same(a: Matches, b: Matches) -> None:
    assert pairs(a) == pairs(b)
    np.testing.assert_array_equal(a.distances, b.distances)


@pytest.mark.parametrize(("count", "k"), [(150, 5), (150, 1), (40, 100)])
@pytest.mark.parametrize("window_nats", [EVERYTHING, 12.0, 3.0])
def test_the_likeliest_of_the_own_class_among_the_allowed_are_found_in_order(count, k, window_nats):
    entries, queries = gathered(count, seed=1), gathered(30, seed=2)
    allowed = np.random.default_rng(3).random(count) < 0.6
    steps = scores(entries, queries, in_steps=True)
    steps[:, ~allowed] = -np.inf
    expected = []
    for query, row in enumerate(steps):
        likely = [entry for entry in np.argsort(-row, kind="stable") if row[entry] >= row.max() - 32 * window_nats]
        expected += [(query, int(entry)) for entry in likely[:k] if np.isfinite(row[entry])]
    assert pairs(filled(entries, window_nats=window_nats).search(queries, k, allowed)) == expected


def test_distances_are_what_the_likelihoods_of_the_descriptor_lack():
    """Up to half a step a neighbour, and to what exceeds the largest byte."""
    descriptor, entries = RingLikelihood(), gathered(120, seed=4)
    queries = gathered(120, seed=4, noise_m=0.3)
    index = filled(entries)
    matches = index.search(queries, 10, everyone(index))
    lacking = descriptor.max_nats(queries)[:, None] - scores(entries, queries, in_steps=False)
    cells = descriptor.cells(queries)
    for query, entry, distance in zip(matches.queries, matches.entries, matches.distances, strict=True):
        own = slice(queries.offsets[query], queries.offsets[query + 1])
        vector = descriptor.describe(entries[np.array([entry])])[0, cells[own]]
        lost = np.maximum(vector - 255 * STEP_NATS, 0.0).sum()
        expected = max(lacking[query, entry] + lost, 0.0)
        assert distance == pytest.approx(expected, abs=0.5 * STEP_NATS * len(vector) + 1e-3)


def test_ties_go_to_the_lower_number():
    entry = constellation([(1, 20.25, 0.0), (3, 30.25, 1.0)])
    index = LikelihoodIndex(RingLikelihood())
    for turned_rad in range(5):
        index.add(constellation([(1, 20.25, turned_rad), (3, 30.25, 2.0 * turned_rad)]))
    index.add(constellation([(1, 20.25, 0.0)]))
    assert index.search(entry, 3, everyone(index)).entries.tolist() == [0, 1, 2]
    allowed = np.array([False, True, False, True, True, True])
    assert index.search(entry, 3, allowed).entries.tolist() == [1, 3, 4]


@pytest.mark.parametrize("size", [1, 7, 64, 65, CHUNK])
def test_adding_in_pieces_is_adding_at_once(size):
    entries, queries = gathered(CHUNK + 150, seed=10, side_m=300.0), gathered(20, seed=11, side_m=100.0)
    pieces = LikelihoodIndex(RingLikelihood())
    for start in range(0, len(entries), size):
        rows = np.arange(start, min(start + size, len(entries)))
        np.testing.assert_array_equal(pieces.add(entries[rows]), rows)
        assert len(pieces) == rows[-1] + 1
    at_once = filled(entries, window_nats=12.0)
    allowed = np.random.default_rng(12).random(len(entries)) < 0.7
    assert_same(pieces.search(queries, 6, allowed), at_once.search(queries, 6, allowed))


def with_classes(count: int, classes: int, *, seed: int) -> Constellations:
    """A scattered map with the first so many of six classes."""
    positions, _ = scattered(count, seed=seed, side_m=100.0)
    labels = np.random.default_rng(seed).integers(classes, size=count)
    vocabulary = (*VOCABULARY, "fountain", "wall")[:classes]
    return gather_constellations(positions, labels, vocabulary, radius_m=RADIUS_M)


def in_larger_vocabulary(constellations: Constellations, vocabulary: tuple[str, ...]) -> Constellations:
    c = constellations
    return Constellations(c.positions, c.labels, c.centre_labels, c.offsets, vocabulary, c.centres)


def test_the_vocabulary_may_grow_at_its_end_as_if_it_had_been_that_large_from_the_start():
    maps = [with_classes(60, classes, seed=classes) for classes in (3, 4, 6)]
    queries = with_classes(40, 6, seed=20)
    grown, large = LikelihoodIndex(RingLikelihood()), LikelihoodIndex(RingLikelihood())
    for entries in maps:
        grown.add(entries)
        large.add(in_larger_vocabulary(entries, queries.vocabulary))
        assert_same(
            grown.search(queries, 6, everyone(grown)),
            large.search(queries, 6, everyone(large)),
        )


@pytest.mark.parametrize(("entries", "queries", "allowed"), [(0, 3, True), (20, 0, True), (20, 3, False)])
def test_nothing_is_found_in_an_empty_index_for_no_query_or_among_none_allowed(entries, queries, allowed):
    index = filled(gathered(entries, seed=15))
    matches = index.search(gathered(queries, seed=15), 4, np.full(entries, allowed))
    assert len(index) == entries
    assert len(matches.queries) == len(matches.entries) == len(matches.distances) == 0
    assert (matches.queries.dtype, matches.distances.dtype) == (np.int64, np.float32)


def test_fewer_are_described_at_a_time_where_there_are_many_classes():
    few, many = (in_larger_vocabulary(gathered(9, seed=1), tuple(map(str, range(size)))) for size in (64, 5000))
    assert (count_at_a_time(few), count_at_a_time(many)) == (CHUNK, 6)


@pytest.mark.parametrize("count", [256, 257, 258, 259, 1000])
def test_hundreds_of_neighbours_add_up_without_overflow(count):
    """Their bytes do not fit in two."""
    crowd = constellation([(1, 2.25, 0.0)] * count)
    index = LikelihoodIndex(RingLikelihood(1e4 / count), window_nats=EVERYTHING)
    index.add(constellation([(1, 2.25, 0.0)]))
    index.add(crowd)
    matches = index.search(crowd, 2, everyone(index))
    assert matches.entries.tolist() == [1, 0]
    lacking = count * (8.0 - 255 * STEP_NATS)
    assert matches.distances[0] == pytest.approx(max(lacking, 0.0), abs=0.1)


class NearLikelihood(RingLikelihood):
    """Asks the neighbours up to 15 m apart."""

    def __init__(self) -> None:
        super().__init__()
        self.near_m = 15.0


def test_what_is_beyond_the_end_of_the_map_does_not_hide_what_is_near():
    """Many neighbours that the map lacks stand like those of other objects; few near ones are as the map has them."""
    here = [(1, 4.25, 0.0), (2, 7.25, 1.0), (3, 11.25, 2.0)]
    beyond = [(1, 20.25 + 2.5 * step, 0.3 * step) for step in range(12)]
    entries = [constellation(here), *[constellation([*beyond[: 6 + rank], (2, 9.75, 0.0)]) for rank in range(6)]]
    query = constellation([*here, *beyond])
    found = {}
    for descriptor in (RingLikelihood(), NearLikelihood()):
        index = LikelihoodIndex(descriptor, window_nats=EVERYTHING)
        for entry in entries:
            index.add(entry)
        found[type(descriptor)] = index.search(query, 4, everyone(index)).entries.tolist()
    assert 0 not in found[RingLikelihood]
    assert 0 in found[NearLikelihood]
    assert found[NearLikelihood][:2] == found[RingLikelihood][:2]
    assert len(set(found[NearLikelihood])) == 4


def test_near_neighbours_are_not_asked_apart_where_all_decide_or_none_is_near():
    index, plain = LikelihoodIndex(NearLikelihood()), LikelihoodIndex(RingLikelihood())
    entries = gathered(150, seed=26, side_m=150.0)
    index.add(entries)
    plain.add(entries)
    again = gathered(150, seed=26, side_m=150.0, noise_m=0.1)
    decided = plain.search(again, 6, everyone(plain))
    clear = np.flatnonzero(np.bincount(decided.queries, minlength=150) < 6)
    assert len(clear) > 50
    far = thinned(again, np.hypot(again.positions[:, 0], again.positions[:, 1]) > 15.0)
    for queries in (again[clear], far):
        assert_same(index.search(queries, 6, everyone(index)), plain.search(queries, 6, everyone(plain)))


@pytest.mark.parametrize("k", [1, 2, 5, 6, 200])
def test_near_neighbours_give_no_match_twice_and_leave_the_likeliest_first(k):
    entries, queries = gathered(60, seed=27), gathered(30, seed=28)
    index, plain = LikelihoodIndex(NearLikelihood(), EVERYTHING), LikelihoodIndex(RingLikelihood(), EVERYTHING)
    index.add(entries)
    plain.add(entries)
    matches, likeliest = (each.search(queries, k, everyone(each)) for each in (index, plain))
    assert len(set(pairs(matches))) == len(pairs(matches)) == len(pairs(likeliest))
    for query in range(30):
        own, theirs = (each.entries[each.queries == query] for each in (matches, likeliest))
        assert own[: k - k // 2].tolist() == theirs[: k - k // 2].tolist()
        assert (np.diff(matches.distances[matches.queries == query]) >= 0.0).all()
