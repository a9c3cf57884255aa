"""Pairs of labelled objects: those of a map by their classes and lengths, and those of a query that can be them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from slam.common.arrays import ComplexArray, FloatArray, IntArray
from slam.registration.parameters import RegistrationConfig

CHUNKS = (2**10, 2**13)
"""Proposals in the first chunk, which may be enough, and in the largest: what stays in the processor's cache."""


@dataclass(frozen=True, slots=True, eq=False)
class MapPairs:
    """P pairs of map objects, the one of the smaller class ``first``, sorted by ``keys``: classes, then lengths.

    A key is the number of the two classes times ``stride``, plus the length in metres, which is less.
    """

    first: IntArray
    second: IntArray
    keys: FloatArray
    stride: float
    classes: int

    @classmethod
    def of(cls, plane: ComplexArray, labels: IntArray, tree: cKDTree, classes: int, reach_m: float) -> MapPairs:
        """All pairs within ``reach_m`` of objects ``plane`` (M,) m, which are in ``tree``, with labels (M,)."""
        pairs: IntArray = tree.query_pairs(reach_m, output_type="ndarray")
        swapped = labels[pairs[:, 0]] > labels[pairs[:, 1]]
        first, second = np.where(swapped, pairs[:, 1], pairs[:, 0]), np.where(swapped, pairs[:, 0], pairs[:, 1])
        stride = 2.0 * reach_m
        lengths = np.asarray(np.abs(plane[second] - plane[first]), dtype=np.float64)
        keys = (labels[first] * classes + labels[second]) * stride + lengths
        order = np.argsort(keys, kind="stable")
        return cls(first[order], second[order], keys[order], stride, classes)

    def stretches(
        self, first: IntArray, second: IntArray, shortest: FloatArray, longest: FloatArray
    ) -> tuple[IntArray, IntArray]:
        """Where the pairs of classes ``first`` <= ``second`` (Q,), that long, start and end."""
        base = (first * self.classes + second) * self.stride
        start = np.searchsorted(self.keys, base + np.clip(shortest, 0.0, 0.75 * self.stride))
        return start, np.searchsorted(self.keys, base + np.clip(longest, 0.0, 0.75 * self.stride), side="right")


@dataclass(frozen=True, slots=True, eq=False)
class QueryPairs:
    """Q pairs of query objects, and from where to where in the list of map pairs those are that each can be.

    ``order`` (N,) are the query's objects, first those that take part in few proposals: they tell places apart. Pairs
    are sorted by ``stage``, the later one of their objects in that order, and then by how many proposals they make.
    """

    first: IntArray
    second: IntArray
    start: IntArray
    end: IntArray
    stage: IntArray
    order: IntArray

    def proposals(self) -> Iterator[tuple[int, IntArray, IntArray]]:
        """Chunks of proposals: which pair of the query (H,) may be which pair of the map (H,).

        Before these, the number of objects, the first ones in ``order``, all pairs of which are in earlier chunks.
        """
        after = np.cumsum(self.end - self.start)
        before = after - (self.end - self.start)
        total = int(after[-1]) if len(after) else 0
        begin, size = 0, CHUNKS[0]
        while begin < total:
            flat = np.arange(begin, min(begin + size, total))
            chosen = np.searchsorted(after, flat, side="right")
            yield int(self.stage[chosen[0]]), chosen, self.start[chosen] + flat - before[chosen]
            begin, size = begin + size, min(2 * size, CHUNKS[1])


def query_pairs(
    map_pairs: MapPairs,
    plane: ComplexArray,
    classes: IntArray,
    variances: FloatArray,
    config: RegistrationConfig,
    *,
    map_sigma_m: float,
) -> QueryPairs:
    """All pairs that can be pairs of the map; two objects of one class are two pairs, one each way round.

    Args:
        map_pairs: those of the map.
        plane: (N,) m, the query's objects as x + iy.
        classes: (N,) numbered as those of the map.
        variances: (N,) m^2, along any axis.
        config: of which the gate, the least baseline and the scale are used.
        map_sigma_m: noise of the map's objects along any axis, the largest of them.
    """
    count = len(plane)
    first, second = np.nonzero((classes[:, None] <= classes) & ~np.eye(count, dtype=bool))
    lengths = np.abs(plane[second] - plane[first])
    variance = variances[first] + variances[second] + 2.0 * map_sigma_m**2
    if config.estimate_scale:
        variance += (config.scale_sigma * lengths) ** 2
    tolerance = config.gate_sigma * np.sqrt(variance)
    start, end = map_pairs.stretches(
        classes[first], classes[second], np.maximum(lengths - tolerance, config.min_baseline_m), lengths + tolerance
    )
    possible = np.flatnonzero((end > start) & (lengths >= config.min_baseline_m))
    first, second, start, end = first[possible], second[possible], start[possible], end[possible]
    proposals = (end - start).astype(np.float64)
    work = np.bincount(first, proposals, count) + np.bincount(second, proposals, count)
    order = np.argsort(work, kind="stable")
    rank = np.empty(count, dtype=np.int64)
    rank[order] = np.arange(count)
    stage = np.maximum(rank[first], rank[second])
    by_stage = np.lexsort((end - start, stage))
    return QueryPairs(first[by_stage], second[by_stage], start[by_stage], end[by_stage], stage[by_stage], order)
