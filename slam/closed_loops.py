"""The closures that are part of the map: factors of the graph and merged landmarks; each can be taken out again."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

from slam.candidate import Candidate
from slam.factor_graph import FactorGraph
from slam.matching import PASS_TRAVEL_M
from slam.object_map import LandmarkState, ObjectMap


@dataclass(frozen=True, slots=True, eq=False)
class ClosedLoop:
    """A closure with the number of its factor and the landmarks that lost their names by it."""

    candidate: Candidate
    factor: int
    merged: tuple[int, ...]


class ClosedLoops:
    """Inserts closures and takes them out."""

    def __init__(self, object_map: ObjectMap, graph: FactorGraph) -> None:
        self._map = object_map
        self._graph = graph
        self._namesakes: defaultdict[int, list[int]] = defaultdict(list)
        self.loops: list[ClosedLoop] = []

    def nearest(self, travel_m: float) -> ClosedLoop | None:
        """The closure whose query is nearest in travel."""
        return min(self.loops, key=lambda loop: abs(loop.candidate.travel_m - travel_m), default=None)

    def insert(self, candidate: Candidate) -> None:
        """Tie the two keyframes together and make one of the landmarks that meet."""
        factor = self._graph.add_edge(candidate.edge())
        merged = [self._merge(int(query), int(reference)) for query, reference in candidate.pairs]
        self.loops.append(ClosedLoop(candidate, factor, tuple(row for row in merged if row is not None)))

    def withdraw(self, loop: ClosedLoop) -> None:
        """Take a closure out of the graph again, and let its landmarks be two."""
        self._graph.remove_factor(loop.factor)
        for row in reversed(loop.merged):
            self._namesakes[self._map.current(row)].remove(row)
            self._map.split(row)
            self._graph.split_landmark(row)
        self.loops.remove(loop)

    def _merge(self, query: int, reference: int) -> int | None:
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
        dropped = self._map.merge(kept, query)
        if dropped is not None:
            self._graph.merge_landmarks(kept, dropped)
            self._namesakes[kept].append(dropped)
        return dropped
