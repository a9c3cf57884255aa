"""Union-find with undo, against sets that are copied before each merge."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slam.common.union_find import Merge, UnionFind, find_components

ITEMS = 9
PAIRS = st.tuples(st.integers(0, ITEMS - 1), st.integers(0, ITEMS - 1))
STEPS = st.lists(st.one_of(PAIRS, st.none()), max_size=40)  # None: undo the last merge


class Naive:
    """Who stands for each item, and what each item absorbed; all of it copied before each merge."""

    def __init__(self) -> None:
        self.names = list(range(ITEMS))
        self.absorbed: list[list[int]] = [[] for _ in range(ITEMS)]
        self.before: list[tuple[list[int], list[list[int]]]] = []

    def merge(self, kept: int, dropped: int) -> None:
        self.before.append((list(self.names), [list(each) for each in self.absorbed]))
        kept, dropped = self.names[kept], self.names[dropped]
        self.absorbed[kept] += [*self.absorbed[dropped], dropped]
        self.names = [kept if name == dropped else name for name in self.names]

    def undo(self) -> None:
        self.names, self.absorbed = self.before.pop()


def play(steps: list[tuple[int, int] | None]) -> tuple[UnionFind, Naive]:
    sets, naive = UnionFind(), Naive()
    done: list[Merge] = []
    for step in steps:
        if step is None:
            if done:
                sets.undo(done.pop())
                naive.undo()
        elif (merge := sets.merge(*step)) is not None:
            done.append(merge)
            naive.merge(*step)
        else:
            assert naive.names[step[0]] == naive.names[step[1]]
    assert sets.history == tuple(done)
    return sets, naive


@given(STEPS)
def test_it_agrees_with_sets_that_are_copied(steps):
    sets, naive = play(steps)
    assert [sets.find(item) for item in range(ITEMS)] == naive.names
    assert [sorted(sets.absorbed(item)) for item in range(ITEMS)] == [sorted(each) for each in naive.absorbed]
    assert [sets.is_dropped(item) for item in range(ITEMS)] == [name != item for item, name in enumerate(naive.names)]
    assert sorted(sets.dropped) == [item for item, name in enumerate(naive.names) if name != item]


@given(st.lists(PAIRS, max_size=20))
def test_undoing_everything_leaves_every_item_on_its_own(pairs):
    sets, _ = play([*pairs, *[None] * len(pairs)])
    assert [sets.find(item) for item in range(ITEMS)] == list(range(ITEMS))
    assert len(sets) == 0
    assert sets.dropped == []


def test_who_is_kept_stands_for_both_however_small_its_set():
    sets = UnionFind()
    for item in (1, 2, 3):
        sets.merge(0, item)
    sets.merge(9, 2)
    assert {sets.find(item) for item in (0, 1, 2, 3, 9)} == {9}


def test_a_merge_tells_what_was_given_and_what_stood_for_it():
    sets = UnionFind()
    sets.merge(1, 2)
    sets.merge(4, 5)
    assert sets.merge(2, 5) == Merge(kept_item=2, dropped_item=5, kept=1, dropped=4)


def test_what_was_absorbed_comes_in_the_order_of_the_merges():
    sets = UnionFind()
    for pair in ((5, 3), (7, 1), (7, 5), (0, 7)):
        sets.merge(*pair)
    assert sets.absorbed(7) == [3, 1, 5]
    assert sets.absorbed(0) == [3, 1, 5, 7]


def test_only_the_last_merge_can_be_undone():
    sets = UnionFind()
    first, second = sets.merge(0, 1), sets.merge(2, 3)
    assert first is not None
    assert second is not None
    with pytest.raises(ValueError, match="only the last merge"):
        sets.undo(first)
    sets.undo(second)
    sets.undo(first)
    with pytest.raises(ValueError, match="only the last merge"):
        sets.undo(first)


@pytest.mark.slow
def test_a_long_chain_of_merges_stays_shallow():
    sets = UnionFind()
    count = 200_000
    for item in reversed(range(count)):
        sets.merge(item, item + 1)
    assert {sets.find(item) for item in range(count + 1)} == {0}


@given(st.lists(PAIRS, max_size=20))
def test_a_component_has_the_name_of_its_least_item(pairs):
    names = find_components(ITEMS, np.array(pairs, dtype=np.int64).reshape(-1, 2))
    reached = np.eye(ITEMS, dtype=np.bool_)
    for first, second in pairs:
        reached[first, second] = reached[second, first] = True
    for _ in range(ITEMS):
        reached = reached @ reached
    np.testing.assert_array_equal(names, reached.argmax(axis=1))
