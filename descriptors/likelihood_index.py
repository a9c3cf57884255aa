"""Which object of the map made what is seen: all of the same class, by the likelihood of the neighbours."""

from __future__ import annotations

from itertools import pairwise
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from descriptors.constellation import Constellations
from descriptors.index import Matches

CHUNK = 512
"""Constellations of up to 64 classes that are described at a time, which bounds the memory."""
STEP_NATS = 1.0 / 32.0
"""Entries are kept in bytes, a quarter of the memory: 8 nats from the least on, which hold all but one neighbour in the
first ring."""


class NeighbourLikelihood(Protocol):
    """A descriptor whose vectors are log-likelihood ratios of a neighbour in each of their cells."""

    @property
    def radius_m(self) -> float:
        """How far neighbours count."""
        ...

    @property
    def near_m(self) -> float:
        """How far an object's neighbours are near; ``radius_m`` where they are not asked apart from all others."""
        ...

    @property
    def min_nats(self) -> float:
        """What is below that is kept as that; 0 where an object of the map never speaks against itself."""
        ...

    def describe(self, constellations: Constellations) -> NDArray[np.float32]:
        """Vectors (B, cells) of objects of the map, in nats."""
        ...

    def cells(self, constellations: Constellations) -> NDArray[np.int64]:
        """Which entry (P,) of a vector each neighbour falls into, where it is observed."""
        ...

    def max_nats(self, constellations: Constellations) -> NDArray[np.float32]:
        """The most that a query (B,) could score."""
        ...


class LikelihoodIndex:
    """Grows by rows; an entry's row is its number. The vocabulary may grow, too, at its end.

    ``window_nats``: entries that are less likely than the best by more than that are no matches.
    """

    def __init__(self, descriptor: NeighbourLikelihood, window_nats: float = 12.0) -> None:
        self._descriptor = descriptor
        self._window_steps = round(window_nats / STEP_NATS)
        self._shelves: dict[int, _Shelf] = {}  # by the class of the entries
        self._size = 0

    @property
    def radius_m(self) -> float:
        """How far neighbours count."""
        return self._descriptor.radius_m

    @property
    def nbytes(self) -> int:
        """Memory of the tables and of the numbers of their columns, without what is reserved."""
        return sum(shelf.nbytes for shelf in self._shelves.values())

    def __len__(self) -> int:
        return self._size

    def add(self, constellations: Constellations) -> NDArray[np.int64]:
        """Add entries; returns their numbers (B,)."""
        numbers = np.arange(self._size, self._size + len(constellations))
        step = count_at_a_time(constellations)
        for start in range(0, len(constellations), step):
            chunk = constellations[np.arange(start, min(start + step, len(constellations)))]
            nats = self._descriptor.describe(chunk)
            for label in np.unique(chunk.centre_labels):
                rows = np.flatnonzero(chunk.centre_labels == label)
                self._shelves.setdefault(int(label), _Shelf(self._descriptor.min_nats)).add(
                    nats[rows], numbers[start + rows]
                )
        self._size += len(constellations)
        return numbers

    def search(self, constellations: Constellations, k: int, allowed: NDArray[np.bool_]) -> Matches:
        """Up to ``k`` likeliest entries of its own class for each query among the ``allowed`` (size,) ones.

        Where that many are within the window, half of them (rounded down) are the likeliest others by the neighbours
        up to ``near_m`` of the descriptor instead. A match's distance is what it lacks to the most that the query could
        score, in nats. Ties go to the lower number.
        """
        queries, entries = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
        lacking = [np.zeros(0, np.float32)]
        for label, shelf in sorted(self._shelves.items()):
            rows = np.flatnonzero(constellations.centre_labels == label)
            columns = np.flatnonzero(allowed[shelf.numbers])
            if len(rows) == 0 or len(columns) == 0:
                continue
            asking = constellations[rows]
            steps = shelf.steps(self._descriptor.cells(asking), asking.offsets, columns)
            places, likely = _likeliest(steps, k, self._window_steps)
            if self._descriptor.near_m < self._descriptor.radius_m:
                places, likely = self._half_by_near(shelf, asking, columns, steps, (places, likely), k)
            queries.append(rows[places])
            entries.append(shelf.numbers[columns[likely]])
            nats = (steps[places, likely] - shelf.zero * np.diff(asking.offsets)[places]) * STEP_NATS
            lacking.append(self._descriptor.max_nats(asking)[places] - nats)
        found = np.concatenate(queries)
        order = np.argsort(found, kind="stable")
        distances = np.maximum(np.concatenate(lacking), 0.0).astype(np.float32)
        return Matches(found[order], np.concatenate(entries)[order], distances[order])

    def _half_by_near(
        self,
        shelf: _Shelf,
        asking: Constellations,
        columns: NDArray[np.int64],
        steps: NDArray[np.int32],
        matches: tuple[NDArray[np.int64], NDArray[np.int64]],
        k: int,
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Matches, row and column (C,) each, of which half are replaced where a query has ``k``: there all neighbours
        together do not decide, and those near by may, if the map ends among the others.
        """
        rows, likely = matches
        is_open = np.bincount(rows, minlength=len(asking)) == k
        if k < 2 or not is_open.any():
            return matches
        near = asking[np.flatnonzero(is_open)].within(self._descriptor.near_m)
        by_near = shelf.steps(self._descriptor.cells(near), near.offsets, columns)
        has_near = np.diff(near.offsets) > 0
        is_open[is_open] = has_near
        by_near = by_near[has_near]
        ranks = np.arange(len(rows)) - rows.searchsorted(rows)
        stays = (ranks < k - k // 2) | ~is_open[rows]
        rows, likely = rows[stays], likely[stays]
        taken = is_open[rows]
        by_near[(np.cumsum(is_open) - 1)[rows[taken]], likely[taken]] = -1
        more, more_likely = _likeliest(by_near, k // 2, self._window_steps)
        rows = np.concatenate([rows, np.flatnonzero(is_open)[more]])
        likely = np.concatenate([likely, more_likely])
        order = np.lexsort((likely, -steps[rows, likely], rows))
        return rows[order], likely[order]


class _Shelf:
    """Entries of one class: a column of bytes each, a row for each cell of the vectors; ``zero`` stands for 0 nats."""

    def __init__(self, min_nats: float) -> None:
        self.zero = round(-min_nats / STEP_NATS)
        self._table = np.zeros((0, 4), dtype=np.uint8)  # few, as there may be many classes
        self.numbers = np.zeros(0, dtype=np.int64)

    @property
    def nbytes(self) -> int:
        """Memory of the columns and their numbers."""
        return len(self.numbers) * (self._table.shape[0] * self._table.itemsize + self.numbers.itemsize)

    def add(self, nats: NDArray[np.float32], numbers: NDArray[np.int64]) -> None:
        """Vectors (B, cells), no shorter than those before, under their numbers (B,)."""
        start, end = len(self.numbers), len(self.numbers) + len(numbers)
        cells, capacity = self._table.shape
        if end > capacity or nats.shape[1] > cells:
            shape = nats.shape[1], capacity if end <= capacity else max(end, 2 * capacity)
            grown = np.full(shape, self.zero, dtype=np.uint8)
            grown[:cells, :start] = self._table[:, :start]
            self._table = grown
        self._table[:, start:end] = np.clip(np.rint(nats / STEP_NATS) + self.zero, 0.0, 255.0).T
        self.numbers = np.concatenate([self.numbers, numbers])

    def steps(
        self, cells: NDArray[np.int64], offsets: NDArray[np.int64], columns: NDArray[np.int64]
    ) -> NDArray[np.int32]:
        """What the neighbours in ``cells``, those of a query between two ``offsets`` (Q + 1,), say for each entry.

        (Q, M) for the entries in ``columns`` (M,), in :data:`STEP_NATS`, 0 or more.
        """
        known = cells < len(self._table)  # a class that came later is nowhere near the older entries
        rows = self._table[cells[known], : len(self.numbers)]
        starts = np.concatenate([[0], np.cumsum(known)])[offsets]
        total = np.zeros((len(offsets) - 1, len(self.numbers)), dtype=np.int32)
        for query, (start, end) in enumerate(pairwise(starts)):  # thirty times as fast as one reduceat
            kind = np.uint16 if end - start <= 257 else np.uint32  # 257 bytes add up to less than 2^16
            total[query] = np.add.reduce(rows[start:end], axis=0, dtype=kind)
        total += (self.zero * (np.diff(offsets) - np.diff(starts)))[:, None].astype(np.int32)
        return total if len(columns) == len(self.numbers) else total[:, columns]


def count_at_a_time(constellations: Constellations) -> int:
    """How many to describe at once: fewer where a vector is long for its many classes."""
    return int(np.clip(CHUNK * 64 // max(len(constellations.vocabulary), 1), 1, CHUNK))


def _likeliest(steps: NDArray[np.int32], k: int, window: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Row and column, each (C,), of up to ``k`` largest values of each row within ``window`` of the largest one."""
    least = steps.max(axis=1) - window
    if k < steps.shape[1]:
        least = np.maximum(least, np.partition(steps, -k, axis=1)[:, -k])
    rows, columns = np.nonzero(steps >= least[:, None])
    order = np.lexsort((columns, -steps[rows, columns], rows))
    rows, columns = rows[order], columns[order]
    ranks = np.arange(len(rows)) - rows.searchsorted(rows)
    return rows[ranks < k], columns[ranks < k]
