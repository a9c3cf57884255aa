"""Accepted closures in the factor graph and the landmarks merged by them; each can be removed again."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace

from slam.backend.factor_graph import FactorGraph
from slam.loop_closure.candidate import Candidate
from slam.object_map.landmarks import LandmarkState, ObjectMap
from slam.odometry.keyframe import Keyframe
from slam.odometry.segments import SegmentConnectivity


@dataclass(frozen=True, slots=True, eq=False)
class ClosedLoop:
    """A closure with the number of its factor and the pairs (kept, dropped) of landmarks that it merged."""

    candidate: Candidate
    factor: int
    merged: tuple[tuple[int, int], ...]


class ClosedLoops:
    """Inserts closures into graph and map, and removes them.

    Landmarks whose travel differs by less than ``min_travel_m`` are of one traversal: no closure can relate them.
    """

    def __init__(
        self, object_map: ObjectMap, graph: FactorGraph, keyframes: Sequence[Keyframe], *, min_travel_m: float
    ) -> None:
        self._min_travel_m = min_travel_m
        self._segments = SegmentConnectivity(keyframes)
        self._map = object_map
        self._graph = graph
        self._aliases: defaultdict[int, list[int]] = defaultdict(list)
        self.loops: list[ClosedLoop] = []

    def nearest(self, travel_m: float) -> ClosedLoop | None:
        """The closure whose query is nearest in travel."""
        return min(self.loops, key=lambda loop: abs(loop.candidate.travel_m - travel_m), default=None)

    def are_connected(self, first: int, second: int) -> bool:
        """Whether odometry or closures connect two keyframes."""
        return self._segments.are_connected(first, second)

    def insert(self, candidate: Candidate) -> None:
        """Add the closure as a factor and merge the matched landmarks.

        If its keyframes are in segments that were not connected before, the later segment is first moved rigidly to
        where the closure puts it.
        """
        moved = self._segments.connect(candidate.reference, candidate.query)
        edge = candidate.edge()
        factor = self._graph.add_joining_edge(edge, moved) if len(moved) else self._graph.add_edge(edge)
        self.loops.append(ClosedLoop(candidate, factor, self._merge_all(candidate)))

    def remove(self, loops: Sequence[ClosedLoop]) -> None:
        """Remove closures from the graph and split the landmarks that only they merged."""
        if not loops:
            return
        gone = [loop.factor for loop in loops]
        for factor in gone:
            self._graph.remove_factor(factor)
        # A later merge may refer to the alias that an earlier one created: all merges are redone.
        for loop in reversed(self.loops):
            for _, dropped in reversed(loop.merged):
                self._map.split(dropped)
                self._graph.split_landmark(dropped)
        self._aliases.clear()
        self._segments.reset()
        self.loops = [
            replace(loop, merged=self._merge_all(loop.candidate)) for loop in self.loops if loop.factor not in gone
        ]
        for loop in self.loops:
            self._segments.connect(loop.candidate.reference, loop.candidate.query)

    def _merge_all(self, candidate: Candidate) -> tuple[tuple[int, int], ...]:
        merged = [self._merge(int(query), int(reference)) for query, reference in candidate.pairs]
        return tuple(pair for pair in merged if pair is not None)

    def _merge(self, query: int, reference: int) -> tuple[int, int] | None:
        """Merge the query landmark into the reference landmark; None if they are merged already or must not be."""
        kept = self._map.canonical_id(reference)
        landmarks = self._map.rows
        if self._map.canonical_id(query) != query or self._aliases[query]:
            return None
        # Two landmarks of one traversal are two objects.
        same_traversal = [
            row
            for row in (kept, *self._aliases[kept])
            if abs(landmarks["last_seen_travel_m"][row] - landmarks["last_seen_travel_m"][query]) < self._min_travel_m
        ]
        if same_traversal or landmarks["state"][kept] != LandmarkState.CONFIRMED:
            return None
        self._map.merge(kept, query)
        self._graph.merge_landmarks(kept, query)
        self._aliases[kept].append(query)
        return kept, query
