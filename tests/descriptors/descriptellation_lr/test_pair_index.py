"""The index of pairs: bit-sliced sums are sums, and a view finds its pairs again."""

import numpy as np
import pytest

from descriptors.descriptellation_lr.pair_index import (
    MATCHES_PER_PAIR,
    WORD,
    PairIndex,
    PairMatches,
    _largest,
    _packed,
    _sum,
)
from descriptors.registry import shipped_likelihood

SIGMA_M = 0.3


def town(count: int = 1500, classes: int = 1) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    return rng.uniform(0.0, 10.0 * np.sqrt(count), (count, 2)), rng.integers(classes, size=count)


def indexed(positions: np.ndarray, labels: np.ndarray, **given: np.ndarray) -> PairIndex:
    index = PairIndex(shipped_likelihood())
    index.add(positions, labels, **given)
    return index


def view(positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows of what is seen around a place, and where, in another frame."""
    rng = np.random.default_rng(0)
    rows = np.flatnonzero(np.hypot(*(positions - positions[rng.integers(len(positions))]).T) < 35.0)
    turn = np.array([[0.0, -1.0], [1.0, 0.0]])
    return rows, positions[rows] @ turn.T + 1e4 + rng.normal(0.0, 0.2, (len(rows), 2))


def search(index: PairIndex, seen: np.ndarray, labels: np.ndarray, **given: np.ndarray) -> PairMatches:
    return index.search(seen, labels, sigmas_m=np.full(len(seen), SIGMA_M), **given)


def share_right(matches: PairMatches, rows: np.ndarray, best: int) -> float:
    return float((rows[matches.queries[:best]] == matches.entries[:best]).all(axis=1).mean())


def test_bit_sliced_sums_are_sums() -> None:
    rng = np.random.default_rng(0)
    levels = [rng.random((count, 2, 640)) < 0.3 for count in (9, 0, 4)]
    counters = _sum([[_packed(bits) for bits in level] for level in levels], np.zeros((2, 10), dtype=np.uint64))
    expected = sum(weight * level.sum(axis=0) for weight, level in zip((1, 2, 4), levels, strict=True))
    row, place, values = _largest(counters, np.full((2, 10), ~np.uint64(0)), 640)
    found = np.zeros((2, 640), int)
    found[row, place] = values
    np.testing.assert_array_equal(found, expected)


def test_largest_of_each_row_are_the_largest_that_are_eligible() -> None:
    rng = np.random.default_rng(1)
    values = rng.integers(32, size=(3, 640))
    counters = [_packed((values >> bit) & 1 > 0) for bit in range(5)]
    is_eligible = rng.random((3, 640)) < 0.5
    row, place, found = _largest(counters, _packed(is_eligible), 40)
    np.testing.assert_array_equal(values[row, place], found)
    assert is_eligible[row, place].all()
    for each in range(3):
        least = np.sort(values[each, is_eligible[each]])[-40]
        better = np.flatnonzero(is_eligible[each] & (values[each] > least))
        assert set(better) <= set(place[row == each].tolist())
        assert found[row == each].min() == least
        assert np.count_nonzero(row == each) <= 80


def test_largest_of_equal_values_are_few() -> None:
    every = np.full((1, 1000), ~np.uint64(0))
    row, _, values = _largest([every], every, MATCHES_PER_PAIR)
    assert 0 < len(row) <= MATCHES_PER_PAIR * WORD
    assert (values == 1).all()


@pytest.mark.parametrize("classes", [1, 4])
def test_view_finds_its_pairs_in_another_frame_and_not_when_mirrored(classes: int) -> None:
    positions, labels = town(classes=classes)
    index = indexed(positions, labels)
    rows, seen = view(positions)
    matches = search(index, seen, labels[rows])
    assert share_right(matches, rows, 15) > 0.8
    assert (np.diff(matches.nats) <= 0.0).all()
    mirrored = search(index, seen * [1.0, -1.0], labels[rows])
    assert mirrored.nats.max(initial=-np.inf) < matches.nats.max()


def test_pairs_of_other_classes_do_not_match() -> None:
    positions, labels = town(classes=2)
    rows, seen = view(positions)
    matches = search(indexed(positions, labels), seen, labels[rows])
    np.testing.assert_array_equal(labels[rows][matches.queries], labels[matches.entries])
    assert not len(search(indexed(positions, labels), seen, labels[rows] + 2).nats)


def test_only_allowed_objects_match() -> None:
    positions, labels = town()
    rows, seen = view(positions)
    allowed = np.ones(len(positions), bool)
    allowed[rows] = False
    matches = search(indexed(positions, labels), seen, labels[rows], allowed=allowed)
    assert len(matches.nats)
    assert allowed[matches.entries].all()


def test_arrays_make_the_same_index_and_those_of_another_version_are_refused() -> None:
    positions, labels = town(300, classes=3)
    index = indexed(positions, labels)
    arrays = index.words, index.ends, index.lengths, index.classes
    again = PairIndex.of(shipped_likelihood(), index.unit_m or 0.0, *arrays)
    rows, seen = view(positions)
    first, second = (search(each, seen, labels[rows]) for each in (index, again))
    np.testing.assert_array_equal(first.entries, second.entries)
    assert len(again) == len(index)
    for others in ((index.words[:-1], *arrays[1:]), (index.words, index.ends[:-1], *arrays[2:])):
        with pytest.raises(ValueError, match="another version"):
            PairIndex.of(shipped_likelihood(), 1.0, *others)


@pytest.mark.parametrize("count", [0, 1, 2])
def test_query_or_map_of_hardly_any_objects_is_no_error(count: int) -> None:
    positions, labels = town(60)
    matches = search(indexed(positions, labels), positions[:count], labels[:count])
    assert matches.queries.shape[1] == 2
    few = PairIndex(shipped_likelihood())
    few.add(positions[:count], labels[:count])
    assert (len(few.search(positions, labels, sigmas_m=np.full(60, 100.0)).nats) > 0) == (count == 2)


def test_pair_with_nothing_around_it_matches_pairs_of_its_length() -> None:
    positions = np.array([[0.0, 0.0], [5.0, 0.0], [1e3, 0.0], [1e3 + 9.0, 0.0], [0.0, 1e3], [7.0, 1e3]])
    labels = np.zeros(6, int)
    whole, grown = PairIndex(shipped_likelihood(), 7.0), PairIndex(shipped_likelihood(), 7.0)
    whole.add(positions, labels)
    for first in (0, 2, 4):
        numbers = np.where(np.arange(6) // 2 == first // 2, np.arange(6), -1)
        grown.add(positions, labels, numbers=numbers, centres=np.array([first, first + 1]))
    assert len(grown) == 3
    for index in (whole, grown):
        matches = search(index, positions[2:4], labels[2:4])
        assert {tuple(sorted(pair)) for pair in matches.entries.tolist()} == {(2, 3)}
        at_one_place = 1e-3 * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
        assert len(search(index, at_one_place, labels[:3]).nats) == 0


@pytest.mark.parametrize(("noise_m", "is_found"), [(0.1, False), (1.0, True)])
def test_pair_is_compared_within_the_noise_of_its_own_objects(noise_m: float, is_found: bool) -> None:
    known, labels = np.array([[0.0, 0.0], [5.0, 0.0], [500.0, 0.0], [507.0, 0.0]]), np.zeros(4, int)
    seen = np.array([[0.0, 0.0], [5.0, 0.0], [500.0, 0.0], [508.0, 0.0]])
    matches = indexed(known, labels).search(seen, labels, sigmas_m=np.array([0.1, 0.1, noise_m, noise_m]))
    pairs = {(*sorted(query), *sorted(entry)) for query, entry in zip(matches.queries, matches.entries, strict=True)}
    assert (0, 1, 0, 1) in pairs
    assert ((2, 3, 2, 3) in pairs) == is_found


def test_index_takes_few_bytes_an_object() -> None:
    positions, labels = town(5000)
    assert indexed(positions, labels).nbytes / 5000 <= 256
