"""Accepted closures in the factor graph and the landmarks merged by them; each can be removed again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from slam.backend.factor_graph import FactorGraph
from slam.common.arrays import BoolArray
from slam.loop_closure.candidate import Candidate
from slam.object_map.landmarks import LandmarkMerge, LandmarkState, ObjectMap
from slam.odometry.keyframe import Keyframe
from slam.odometry.segments import SegmentConnectivity


@dataclass(frozen=True, slots=True, eq=False)
class ClosedLoop:
    """A closure with the number of its factor."""

    candidate: Candidate
    factor: int


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
        self.loops: list[ClosedLoop] = []
        self._lasting: list[Candidate] = []  # condensed closures across breaks

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
        moved = self._segments.connect(candidate.reference.id, candidate.query.id)
        edge = candidate.edge()
        factor = self._graph.add_joining_edge(edge, moved) if len(moved) else self._graph.add_edge(edge)
        self.loops.append(ClosedLoop(candidate, factor))
        self._merge_landmarks(self.loops[-1])
        self._graph.alias_landmarks(self._map.aliases)

    def remove(self, loops: Sequence[ClosedLoop]) -> None:
        """Remove closures from the graph and split the landmarks that only they merged."""
        if not loops:
            return
        for loop in loops:
            self._graph.remove_factor(loop.factor)
        gone = {loop.factor for loop in loops}
        self.loops = [loop for loop in self.loops if loop.factor not in gone]
        self._merge_again(self._map.undo_merges(), gone)
        self._segments.reset()
        for each in [*self._lasting, *(loop.candidate for loop in self.loops)]:
            self._segments.connect(each.reference.id, each.query.id)

    def forget_condensed(self) -> None:
        """Forget the closures whose factors are no longer in the graph: nothing can remove them."""
        held = self._graph.factors
        ended = [loop.candidate for loop in self.loops if loop.factor not in held]
        self._lasting += [each for each in ended if each.crosses_break]
        self.loops = [loop for loop in self.loops if loop.factor in held]

    def _merge_again(self, merges: Sequence[LandmarkMerge], gone: set[int]) -> None:
        """Make merges again but for those by closures with the factors ``gone``.

        What a closure may merge depends on the merges before it, so each merges its landmarks anew.
        """
        waiting = {loop.factor: loop for loop in self.loops}
        anew = set(waiting)
        for merge in merges:
            if merge.closure in waiting:
                self._merge_landmarks(waiting.pop(merge.closure))
            elif merge.closure not in gone | anew:  # by the front end, or by a closure that was condensed
                self._map.merge(merge.kept, merge.dropped, closure=merge.closure)
        for loop in waiting.values():
            self._merge_landmarks(loop)
        self._graph.alias_landmarks(self._map.aliases)

    def _merge_landmarks(self, loop: ClosedLoop) -> None:
        for query, reference in loop.candidate.pairs.tolist():
            if self._may_merge(query, reference):
                self._map.merge(reference, query, closure=loop.factor)

    def _may_merge(self, query: int, reference: int) -> bool:
        """Whether the query landmark is not merged, and neither landmark is of both traversals."""
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
