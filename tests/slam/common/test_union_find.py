"""Union-find, against lists of names and of what each item absorbed."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slam.common.union_find import UnionFind, find_components

ITEMS = 9
PAIRS = st.tuples(st.integers(0, ITEMS - 1), st.integers(0, ITEMS - 1))


@given(st.lists(PAIRS, max_size=40))
def test_union_find_agrees_with_lists(pairs):
    sets = UnionFind()
    names, absorbed = list(range(ITEMS)), [list[int]() for _ in range(ITEMS)]
    for first, second in pairs:
        kept, dropped = names[first], names[second]
        assert sets.merge(first, second) is (kept != dropped)
        if kept != dropped:
            absorbed[kept] += [*absorbed[dropped], dropped]
            names = [kept if name == dropped else name for name in names]
    assert [sets.find(item) for item in range(ITEMS)] == names
    assert [sets.absorbed(item) for item in range(ITEMS)] == [sorted(each) for each in absorbed]
    assert sorted(sets.dropped) == [item for item, name in enumerate(names) if name != item]


@pytest.mark.slow
def test_long_chain_of_merges_is_searched_fast():
    sets = UnionFind()
    count = 200_000
    for item in reversed(range(count)):
        sets.merge(item, item + 1)
    assert {sets.find(item) for item in range(count + 1)} == {0}


@given(st.lists(PAIRS, max_size=20))
def test_component_has_the_name_of_its_least_item(pairs):
    names = find_components(ITEMS, np.array(pairs, dtype=np.int64).reshape(-1, 2))
    reached = np.eye(ITEMS, dtype=np.bool_)
    for first, second in pairs:
        reached[first, second] = reached[second, first] = True
    for _ in range(ITEMS):
        reached = reached @ reached
    np.testing.assert_array_equal(names, reached.argmax(axis=1))
