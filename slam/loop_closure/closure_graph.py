"""The closures that are part of the map: factors of the graph and merged landmarks; each can be taken out again."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace

from slam.backend.factor_graph import FactorGraph
from slam.loop_closure.candidate import Candidate
from slam.object_map.landmarks import LandmarkState, ObjectMap
from slam.object_map.submap import PASS_TRAVEL_M
from slam.odometry.keyframe import Keyframe
from slam.odometry.segments import Sessions


@dataclass(frozen=True, slots=True, eq=False)
class ClosedLoop:
    """A closure with the number of its factor, and the landmarks that it merged: what was kept, what lost its name."""

    candidate: Candidate
    factor: int
    merged: tuple[tuple[int, int], ...]


class ClosedLoops:
    """Inserts closures and takes them out."""

    def __init__(self, object_map: ObjectMap, graph: FactorGraph, keyframes: Sequence[Keyframe]) -> None:
        self._sessions = Sessions(keyframes)
        self._map = object_map
        self._graph = graph
        self._namesakes: defaultdict[int, list[int]] = defaultdict(list)
        self.loops: list[ClosedLoop] = []

    def nearest(self, travel_m: float) -> ClosedLoop | None:
        """The closure whose query is nearest in travel."""
        return min(self.loops, key=lambda loop: abs(loop.candidate.travel_m - travel_m), default=None)

    def are_joined(self, first: int, second: int) -> bool:
        """Whether odometry or closures tie two keyframes together."""
        return self._sessions.are_joined(first, second)

    def insert(self, candidate: Candidate) -> None:
        """Tie the two keyframes together and make one of the landmarks that meet.

        Where only a break of the odometry tied them before, one side is moved to the other as a whole first.
        """
        moved = self._sessions.join(candidate.reference, candidate.query)
        edge = candidate.edge()
        factor = self._graph.add_joining_edge(edge, moved) if len(moved) else self._graph.add_edge(edge)
        self.loops.append(ClosedLoop(candidate, factor, self._merge_all(candidate)))

    def withdraw(self, loops: Sequence[ClosedLoop]) -> None:
        """Take closures out of the graph again, and let the landmarks be two that only they made one."""
        if not loops:
            return
        gone = [loop.factor for loop in loops]
        for factor in gone:
            self._graph.remove_factor(factor)
        # What a later closure merged may have gone by a name that an earlier one gave it: all merges are made anew.
        for loop in reversed(self.loops):
            for _, dropped in reversed(loop.merged):
                self._map.split(dropped)
                self._graph.split_landmark(dropped)
        self._namesakes.clear()
        self._sessions.part()
        self.loops = [
            replace(loop, merged=self._merge_all(loop.candidate)) for loop in self.loops if loop.factor not in gone
        ]
        for loop in self.loops:
            self._sessions.join(loop.candidate.reference, loop.candidate.query)

    def _merge_all(self, candidate: Candidate) -> tuple[tuple[int, int], ...]:
        merged = [self._merge(int(query), int(reference)) for query, reference in candidate.pairs]
        return tuple(pair for pair in merged if pair is not None)

    def _merge(self, query: int, reference: int) -> tuple[int, int] | None:
        """Merge the landmark of the query into that of the reference; None where that is done or would be wrong."""
        kept = self._map.current(reference)
        landmarks = self._map.rows
        if self._map.current(query) != query or self._namesakes[query]:
            return None
        # Two objects of one pass are two, whatever else they resemble.
        same_pass = [
            row
            for row in (kept, *self._namesakes[kept])
            if abs(landmarks["last_seen_travel_m"][row] - landmarks["last_seen_travel_m"][query]) < PASS_TRAVEL_M
        ]
        if same_pass or landmarks["state"][kept] != LandmarkState.CONFIRMED:
            return None
        self._map.merge(kept, query)
        self._graph.merge_landmarks(kept, query)
        self._namesakes[kept].append(query)
        return kept, query
