"""Accepted closures in the factor graph and the landmarks merged by them; each can be removed again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from slam.backend.factor_graph import FactorGraph
from slam.common.arrays import BoolArray
from slam.loop_closure.candidate import Candidate
from slam.object_map.landmarks import LandmarkState, ObjectMap
from slam.odometry.keyframe import Keyframe
from slam.odometry.segments import SegmentConnectivity


@dataclass(frozen=True, slots=True, eq=False)
class ClosedLoop:
    """A closure with the number of its factor; ``earlier_merges``, ``merges``: how many merges of landmarks, by
    closures and by the front end, were in force when it was inserted, and how many it made.
    """

    candidate: Candidate
    factor: int
    earlier_merges: int
    merges: int


class ClosedLoops:
    """Inserts closures into graph and map, and removes them.

    Landmarks whose travel differs by less than ``min_travel_m`` are of one traversal: no closure can relate them.
    """

    def __init__(
        self, object_map: ObjectMap, graph: FactorGraph, keyframes: Sequence[Keyframe], *, min_travel_m: float
    ) -> None:
        self._min_travel_m = min_travel_m
        self._keyframes = keyframes
        self._segments = SegmentConnectivity(keyframes)
        self._map = object_map
        self._graph = graph
        self.loops: list[ClosedLoop] = []
        self._lasting: list[tuple[int, int]] = []  # reference and query of condensed closures across breaks

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
        self.loops.append(self._merge_all(candidate, factor))
        self._graph.alias_landmarks(self._map.aliases)

    def remove(self, loops: Sequence[ClosedLoop]) -> None:
        """Remove closures from the graph and split the landmarks that only they merged."""
        if not loops:
            return
        for loop in loops:
            self._graph.remove_factor(loop.factor)
        self._merge_without({loop.factor for loop in loops})
        self._segments.reset()
        for ends in [*self._lasting, *((each.candidate.reference, each.candidate.query) for each in self.loops)]:
            self._segments.connect(*ends)

    def forget_condensed(self) -> None:
        """Forget the closures whose factors are no longer in the graph: nothing can remove them."""
        held = self._graph.factors
        ended = [loop.candidate for loop in self.loops if loop.factor not in held]
        self._lasting += [
            (each.reference, each.query)
            for each in ended
            if self._keyframes[each.reference].odometry.segment != self._keyframes[each.query].odometry.segment
        ]
        self.loops = [loop for loop in self.loops if loop.factor in held]

    def _merge_without(self, gone: set[int]) -> None:
        """Undo all merges since the first of the closures with the factors ``gone``, and make the others again.

        A later merge, of a closure or of the front end, may refer to the alias that an earlier one created.
        """
        since = min(loop.earlier_merges for loop in self.loops if loop.factor in gone)
        undone = self._map.undo_merges(since)
        loops, position = [loop for loop in self.loops if loop.earlier_merges < since], 0
        for loop in self.loops[len(loops) :]:
            start = loop.earlier_merges - since
            self._merge_again(undone[position:start])
            position = start + loop.merges
            if loop.factor not in gone:
                loops.append(self._merge_all(loop.candidate, loop.factor))
        self._merge_again(undone[position:])
        self.loops = loops
        self._graph.alias_landmarks(self._map.aliases)

    def _merge_again(self, merges: Sequence[tuple[int, int]]) -> None:
        """Make merges of the front end again: the same landmarks, by the present aliases of these."""
        for kept, dropped in merges:
            self._map.merge(kept, dropped)

    def _merge_all(self, candidate: Candidate, factor: int) -> ClosedLoop:
        """The closure with this factor, once its matched landmarks are merged."""
        earlier = self._map.merge_count
        for query, reference in candidate.pairs.tolist():
            if self._may_merge(query, reference):
                self._map.merge(reference, query)
        return ClosedLoop(candidate, factor, earlier, self._map.merge_count - earlier)

    def _may_merge(self, query: int, reference: int) -> bool:
        """Whether the query landmark stands for itself, and neither landmark is of both traversals."""
        kept = self._map.canonical_id(reference)
        if self._map.canonical_id(query) != query or self._map.rows["state"][kept] != LandmarkState.CONFIRMED:
            return False
        # Two landmarks of one traversal are two objects; one that stands for two traversals is not merged into a third.
        is_of_both = self._in_traversal(query, [kept, *self._map.absorbed(kept)]).any()
        return not is_of_both and bool(self._in_traversal(query, self._map.absorbed(query)).all())

    def _in_traversal(self, landmark: int, others: list[int]) -> BoolArray:
        """Which other landmarks (N,) were last seen on the same traversal as a landmark."""
        travel_m = self._map.rows["last_seen_travel_m"]
        return np.asarray(np.abs(travel_m[others] - travel_m[landmark]) < self._min_travel_m)
