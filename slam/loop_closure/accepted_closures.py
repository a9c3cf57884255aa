"""The accepted closures: the factors that represent them, the landmarks that they merged, and what goes when one is
revoked.
"""

from collections.abc import Sequence

import numpy as np

from logs.closures import Stage
from logs.messages import LoopClosureRecord
from logs.records import frozen
from slam.backend.factor_graph import FactorGraph
from slam.backend.factors import Edge, EdgeKind
from slam.common.config import Config
from slam.loop_closure.candidate import Candidate
from slam.object_map.landmarks import LandmarkState, ObjectMap
from slam.odometry.keyframe import Keyframe


@frozen
class Accepted:
    """An accepted closure; ``factor``: the number of the factor that represents it in the graph, which is its own if it
    was ``inserted``, or that of a closure nearby.
    """

    candidate: Candidate
    factor: int
    inserted: bool


class AcceptedClosures:
    """Closures in the order in which they were accepted; some are factors, and represent those nearby.

    Landmarks whose travel differs by less than the least travel of a closure are of one traversal: none can relate
    them.
    """

    def __init__(
        self, config: Config, object_map: ObjectMap, graph: FactorGraph, keyframes: Sequence[Keyframe]
    ) -> None:
        # Least travel between two closures that become factors.
        self._insert_travel_m = 2.0 / 3.0 * config.sensor_range_m
        # A relocalization that stayed consistent over that travel is taken to be true.
        self._trusted_after_m = 2.0 * config.sensor_range_m
        self._min_travel_m = config.closure_travel_m
        self._map, self._graph, self._keyframes = object_map, graph, keyframes
        self._components: dict[int, int] = {}  # the first of the segments that closures connect with a segment
        self.closed: dict[int, int] = {}
        """Query and reference keyframe of each."""
        self._accepted: list[Accepted] = []

    def is_localized(self, keyframe: Keyframe) -> bool:
        """Whether odometry or closures connect a keyframe to the first one, and so to the map."""
        return self._component_of(0) == self._component_of(keyframe.id)

    def add(self, candidate: Candidate) -> LoopClosureRecord:
        """Accept a closure; it becomes a factor unless one nearby represents it."""
        travel_m = candidate.query.odometry.travel_m
        apart_m = {each.factor: abs(each.candidate.query.odometry.travel_m - travel_m) for each in self._inserted}
        nearest = min(apart_m, key=apart_m.__getitem__, default=None)
        if nearest is None or apart_m[nearest] >= self._insert_travel_m:
            accepted = Accepted(candidate, self._insert(candidate), inserted=True)
        else:
            accepted = Accepted(candidate, nearest, inserted=False)
        self._accepted.append(accepted)
        self.closed[candidate.query.id] = candidate.reference.id
        seed = candidate.place.predicted_by
        reason = "" if seed is None else f"propagated from the closure of keyframe {seed}"
        return candidate.record(Stage.ACCEPTED, reason, inserted=accepted.inserted)

    def revoke_since(self, keyframe: Keyframe, since: int) -> tuple[list[LoopClosureRecord], bool]:
        """Revoke the closures of a keyframe's segment from the keyframe ``since`` on, which contradict the map.

        If the segment was connected to the map only lately, that relocalization was false
        and all closures of the segment are revoked; otherwise the robot was kidnapped. Returns the records of the
        revoked closures, and whether the robot was kidnapped.
        """
        segment = keyframe.odometry.segment
        poses = [each.query.odometry for each in self._across_breaks]
        connected_m = min((pose.travel_m for pose in poses if pose.segment == segment), default=-np.inf)
        is_kidnapped = keyframe.odometry.travel_m - connected_m > self._trusted_after_m
        if not is_kidnapped:
            since = next(each.id for each in self._keyframes if each.odometry.segment == segment)
        # A closure goes with the factor that represents it, and one that is inconsistent itself goes anyhow.
        gone = {each.factor for each in self._inserted if each.candidate.query.id >= since}
        revoked = [each for each in self._accepted if each.candidate.query.id >= since or each.factor in gone]
        self._remove(revoked)
        reason = "revoked: expected landmarks not observed"
        return [each.candidate.record(Stage.CONSISTENCY, reason) for each in revoked], is_kidnapped

    def settled_before_m(self, travel_m: float) -> float:
        """Closures before the returned travel are not revoked any more, now that the robot has come to ``travel_m``."""
        trusted_m = travel_m - self._trusted_after_m
        return -np.inf if any(each.query.odometry.travel_m > trusted_m for each in self._across_breaks) else trusted_m

    def forget_condensed(self) -> None:
        """Forget the closures whose factors were condensed, and those that they represent: they are part of the map.
        Those across breaks still tell which segments are connected.
        """
        self._accepted = [
            each
            for each in self._accepted
            if each.factor in self._graph.factors or (each.inserted and each.candidate.crosses_break)
        ]

    @property
    def _inserted(self) -> list[Accepted]:
        """The closures that are factors."""
        return [each for each in self._accepted if each.inserted]

    @property
    def _across_breaks(self) -> list[Candidate]:
        """Those across breaks of the odometry."""
        return [each.candidate for each in self._inserted if each.candidate.crosses_break]

    def _insert(self, candidate: Candidate) -> int:
        """Add the closure as a factor and merge the matched landmarks; returns the number of the factor.

        If its keyframes are in segments that were not connected before, the later segment is first moved rigidly to
        where the closure puts it.
        """
        ends = candidate.reference.id, candidate.query.id
        edge = Edge(*ends, candidate.T_reference_query, candidate.covariance, EdgeKind.LOOP_CLOSURE)
        kept, moved = sorted(map(self._component_of, ends))
        if kept == moved:
            factor = self._graph.add_edge(edge)
        else:
            away = {each.id for each in self._keyframes if self._component_of(each.id) == moved}
            factor = self._graph.add_joining_edge(edge, away)
            self._connect(kept, moved)
        for query, reference in candidate.pairs.tolist():
            if self._may_merge(query, reference):
                self._map.merge(reference, query, closure=factor)
        self._graph.alias_landmarks(self._map.aliases)
        self._graph.settle(factor)
        return factor

    def _remove(self, revoked: Sequence[Accepted]) -> None:
        """Remove closures, and split the landmarks that only they merged."""
        for each in revoked:
            self.closed.pop(each.candidate.query.id, None)
        self._accepted = [each for each in self._accepted if each not in revoked]
        gone = {each.factor for each in revoked if each.inserted}
        self._graph.remove_factors(gone)
        self._map.undo_merges(gone)
        self._graph.alias_landmarks(self._map.aliases)
        self._components = {}
        for candidate in self._across_breaks:
            self._connect(*sorted(map(self._component_of, (candidate.reference.id, candidate.query.id))))

    def _connect(self, kept: int, moved: int) -> None:
        """Make one component of two."""
        of_moved = [segment for segment, component in self._components.items() if component == moved]
        self._components |= dict.fromkeys([moved, *of_moved], kept)

    def _component_of(self, keyframe: int) -> int:
        """The first of the segments that are connected with that of a keyframe."""
        segment = self._keyframes[keyframe].odometry.segment
        return self._components.get(segment, segment)

    def _may_merge(self, query: int, reference: int) -> bool:
        """Whether the query landmark is not merged, and neither landmark is of both traversals."""
        canonical, travel_m = self._map.canonical, self._map.rows["last_seen_travel_m"]
        kept = canonical[reference]
        if canonical[query] != query or self._map.rows["state"][kept] != LandmarkState.CONFIRMED:
            return False
        in_traversal = np.abs(travel_m - travel_m[query]) < self._min_travel_m
        # Two landmarks of one traversal are two objects; one that stands for two traversals is not merged into a third.
        return in_traversal[canonical == query].all() and not in_traversal[canonical == kept].any()
