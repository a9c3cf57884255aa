"""Disjoint sets with undo: which items have become one, and which of them stands for all.

Union by size without path compression, so that a merge can be undone: Westbrook, Tarjan, "Amortized analysis of
algorithms for set union with backtracking", SIAM J. Comput. 18(1), 1989.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam.common.arrays import IntArray


@dataclass(frozen=True, slots=True)
class Merge:
    """A merge: the two items that were given, and the representatives (kept, dropped) that their sets had."""

    kept_item: int
    dropped_item: int
    kept: int
    dropped: int


class UnionFind:
    """Disjoint sets of integers; an item that was never merged is a set of its own.

    ``merge`` and ``find`` take O(log n).
    """

    def __init__(self) -> None:
        self._parent: dict[int, int] = {}
        self._size: dict[int, int] = {}
        self._representative: dict[int, int] = {}  # by the root of its tree, where the two differ
        self._absorbed: dict[int, list[int]] = {}  # by the representative that was kept
        self._position: dict[int, int] = {}  # in the history, by the representative that was dropped
        self._history: list[Merge] = []
        self._attached: list[int] = []  # the root that each merge put below another

    def __len__(self) -> int:
        """How many merges are in force."""
        return len(self._history)

    @property
    def history(self) -> tuple[Merge, ...]:
        """The merges that are in force, the oldest first."""
        return tuple(self._history)

    @property
    def dropped(self) -> list[int]:
        """The items that another one stands for, in the order of the merges."""
        return list(self._position)

    def find(self, item: int) -> int:
        """The representative of the set of an item."""
        root = self._root(item)
        return self._representative.get(root, root)

    def is_dropped(self, item: int) -> bool:
        """Whether another item stands for this one."""
        return item in self._position

    def merge(self, kept: int, dropped: int) -> Merge | None:
        """Make one set of those of two items, represented by the representative of ``kept``.

        Returns the merge, for ``undo``; None if the two were in one set already.
        """
        first, second = self._root(kept), self._root(dropped)
        if first == second:
            return None
        merge = Merge(kept, dropped, self._representative.get(first, first), self._representative.get(second, second))
        sizes = self._size.get(first, 1), self._size.get(second, 1)
        root, attached = (first, second) if sizes[0] >= sizes[1] else (second, first)
        self._parent[attached] = root
        self._size[root] = sum(sizes)
        self._representative[root] = merge.kept
        self._absorbed.setdefault(merge.kept, []).append(merge.dropped)
        self._position[merge.dropped] = len(self._history)
        self._history.append(merge)
        self._attached.append(attached)
        return merge

    def undo(self, merge: Merge) -> None:
        """Undo a merge.

        Raises:
            ValueError: it is not the last one in force.
        """
        if not self._history or self._history[-1] is not merge:
            raise ValueError(f"only the last merge can be undone; {merge} is not")
        self._history.pop()
        attached = self._attached.pop()
        root = self._parent.pop(attached)
        self._size[root] -= self._size.get(attached, 1)
        of_attached = self._representative.get(attached, attached)
        self._representative[root] = merge.dropped if of_attached == merge.kept else merge.kept
        self._absorbed[merge.kept].pop()
        del self._position[merge.dropped]

    def absorbed(self, item: int) -> list[int]:
        """The items that were merged into this one while it stood for itself, and into those; in order of merging."""
        found: list[int] = []
        waiting = [item]
        while waiting:
            below = self._absorbed.get(waiting.pop(), [])
            found += below
            waiting += below
        return sorted(found, key=self._position.__getitem__)

    def _root(self, item: int) -> int:
        while item in self._parent:
            item = self._parent[item]
        return item


def find_components(count: int, pairs: IntArray) -> IntArray:
    """The least item (N,) of the connected component of each of N = ``count`` items that pairs (K, 2) connect."""
    sets = UnionFind()
    for first, second in pairs.tolist():
        sets.merge(*sorted((sets.find(first), sets.find(second))))
    return np.array([sets.find(item) for item in range(count)], dtype=np.int64)
