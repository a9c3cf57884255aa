"""Disjoint sets: the items of each set, and the one that represents it."""

from __future__ import annotations

import numpy as np

from slam.common.arrays import IntArray


class UnionFind:
    """Disjoint sets of integers; an item that was never merged is a set of its own."""

    def __init__(self) -> None:
        self._parent: dict[int, int] = {}
        self._absorbed: dict[int, list[int]] = {}  # by the representative that was kept

    @property
    def dropped(self) -> list[int]:
        """The items that another one represents, in the order of the merges."""
        return list(self._parent)

    def find(self, item: int) -> int:
        """The representative of the set of an item."""
        while item in self._parent:
            parent = self._parent[item]
            self._parent[item] = self._parent.get(parent, parent)  # halves the path for the next search
            item = parent
        return item

    def merge(self, kept: int, dropped: int) -> bool:
        """Make one set of those of two items, represented by the representative of ``kept``.

        Returns whether they were two sets.
        """
        first, second = self.find(kept), self.find(dropped)
        if first == second:
            return False
        self._parent[second] = first
        self._absorbed.setdefault(first, []).append(second)
        return True

    def absorbed(self, item: int) -> list[int]:
        """The items that were merged into this one while it represented itself, and into those, ascending."""
        found, waiting = list[int](), [item]
        while waiting:
            below = self._absorbed.get(waiting.pop(), [])
            found += below
            waiting += below
        return sorted(found)


def find_components(count: int, pairs: IntArray) -> IntArray:
    """The least item (N,) of the connected component of each of N = ``count`` items that pairs (K, 2) connect."""
    sets = UnionFind()
    for first, second in pairs.tolist():
        sets.merge(*sorted((sets.find(first), sets.find(second))))
    return np.array([sets.find(item) for item in range(count)], dtype=np.int64)
