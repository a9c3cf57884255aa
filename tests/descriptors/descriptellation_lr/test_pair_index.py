"""The index of pairs: bit-sliced sums are sums, and a view finds its pairs again."""

from __future__ import annotations

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


def town(count: int = 1500, classes: int = 1, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.uniform(0.0, 10.0 * np.sqrt(count), (count, 2)), rng.integers(classes, size=count)


def indexed(positions: np.ndarray, labels: np.ndarray, **given: np.ndarray) -> PairIndex:
    index = PairIndex(shipped_likelihood())
    index.add(positions, labels, **given)
    return index


def view(positions: np.ndarray, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Rows of what is seen around a place, and where, in another frame."""
    rng = np.random.default_rng(seed)
    rows = np.flatnonzero(np.hypot(*(positions - positions[rng.integers(len(positions))]).T) < 35.0)
    turn = np.array([[0.0, -1.0], [1.0, 0.0]])
    return rows, positions[rows] @ turn.T + 1e4 + rng.normal(0.0, 0.2, (len(rows), 2))


def share_right(matches: PairMatches, rows: np.ndarray, best: int) -> float:
    return float((rows[matches.queries[:best]] == matches.entries[:best]).all(axis=1).mean())


def test_bit_sliced_sum_is_the_sum_of_steps_of_set_bits() -> None:
    rng = np.random.default_rng(0)
    bits = rng.random((200, 40)) < 0.3
    cells, steps = rng.integers(40, size=13), rng.integers(1, 8, size=13)
    words = _packed(bits)
    counters = _sum(words, cells, steps, 1, words.shape[1] - 1)
    expected = bits[:, cells] @ steps
    everything = np.full(words.shape[1] - 1, ~np.uint64(0))
    places, values = _largest(counters, everything, 10_000)
    found = np.zeros(words.shape[1] * WORD - WORD, dtype=np.int64)
    found[places] = values
    np.testing.assert_array_equal(found[: 200 - WORD], expected[WORD:])


def test_largest_are_the_largest_that_are_eligible() -> None:
    rng = np.random.default_rng(1)
    values = rng.integers(32, size=640)
    counters = [_packed(((values >> bit) & 1 > 0)[:, None])[0] for bit in range(5)]
    is_eligible = rng.random(640) < 0.5
    places, found = _largest(counters, _packed(is_eligible[:, None])[0], 40)
    np.testing.assert_array_equal(values[places], found)
    assert is_eligible[places].all()
    least = np.sort(values[is_eligible])[-40]
    assert set(np.flatnonzero(is_eligible & (values > least))) <= set(places.tolist())
    assert found.min() == least
    assert len(found) <= 80


def test_largest_of_equal_values_are_few() -> None:
    counters = [np.full(1000, ~np.uint64(0))]
    places, values = _largest(counters, counters[0], MATCHES_PER_PAIR)
    assert 0 < len(places) <= 2 * MATCHES_PER_PAIR * WORD
    assert (values == 1).all()


@pytest.mark.parametrize("classes", [1, 4])
def test_view_finds_its_pairs_in_another_frame_and_not_when_mirrored(classes: int) -> None:
    positions, labels = town(classes=classes)
    index = indexed(positions, labels)
    rows, seen = view(positions)
    matches = index.search(seen, labels[rows], sigma_m=SIGMA_M)
    assert share_right(matches, rows, 15) > 0.8
    assert (np.diff(matches.nats) <= 0.0).all()
    mirrored = index.search(seen * [1.0, -1.0], labels[rows], sigma_m=SIGMA_M)
    assert mirrored.nats.max(initial=-np.inf) < matches.nats.max()


def test_pairs_of_other_classes_do_not_match() -> None:
    positions, labels = town(classes=2)
    rows, seen = view(positions)
    matches = indexed(positions, labels).search(seen, labels[rows], sigma_m=SIGMA_M)
    np.testing.assert_array_equal(labels[rows][matches.queries], labels[matches.entries])
    assert not len(indexed(positions, labels).search(seen, labels[rows] + 2, sigma_m=SIGMA_M).nats)


def test_index_that_grows_finds_what_one_made_at_once_finds() -> None:
    positions, labels = town(400)
    order = np.argsort(positions[:, 0])
    positions, labels = positions[order], labels[order]
    grown = PairIndex(shipped_likelihood(), indexed(positions, labels).unit_m)
    numbers = np.arange(400)
    for start in range(0, 400, 50):
        grown.add(
            positions,
            labels,
            numbers=np.where(numbers < start + 50, numbers, -1),
            centres=np.arange(start, start + 50),
        )
    rows, seen = view(positions, seed=3)
    matches = grown.search(seen, labels[rows], sigma_m=SIGMA_M)
    assert share_right(matches, rows, 15) > 0.8


def test_only_allowed_objects_match() -> None:
    positions, labels = town()
    rows, seen = view(positions)
    allowed = np.ones(len(positions), dtype=bool)
    allowed[rows] = False
    matches = indexed(positions, labels).search(seen, labels[rows], sigma_m=SIGMA_M, allowed=allowed)
    assert len(matches.nats)
    assert allowed[matches.entries].all()


def test_arrays_make_the_same_index_and_those_of_another_version_are_refused() -> None:
    positions, labels = town(300, classes=3)
    index = indexed(positions, labels)
    arrays = index.words, index.ends, index.lengths, index.classes
    again = PairIndex.of(shipped_likelihood(), index.unit_m or 0.0, *arrays)
    rows, seen = view(positions)
    first, second = (each.search(seen, labels[rows], sigma_m=SIGMA_M) for each in (index, again))
    np.testing.assert_array_equal(first.entries, second.entries)
    assert len(again) == len(index)
    with pytest.raises(ValueError, match="another version"):
        PairIndex.of(shipped_likelihood(), 1.0, index.words[:-1], *arrays[1:])
    with pytest.raises(ValueError, match="another version"):
        PairIndex.of(shipped_likelihood(), 1.0, index.words, index.ends[:-1], *arrays[2:])


@pytest.mark.parametrize("count", [0, 1, 2])
def test_query_or_map_of_hardly_any_objects_is_no_error(count: int) -> None:
    positions, labels = town(60)
    matches = indexed(positions, labels).search(positions[:count], labels[:count], sigma_m=SIGMA_M)
    assert matches.queries.shape[1] == 2
    few = PairIndex(shipped_likelihood())
    few.add(positions[:count], labels[:count])
    assert (len(few.search(positions, labels, sigma_m=100.0).nats) > 0) == (count == 2)


def test_index_takes_few_bytes_an_object() -> None:
    positions, labels = town(5000)
    assert indexed(positions, labels).nbytes / 5000 <= 256
