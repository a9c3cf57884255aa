"""The accepted closures: the factors that represent them, and what goes when one is revoked."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from logs.messages import LoopClosureRecord
from slam.backend.factor_graph import FactorGraph
from slam.common.arrays import IntArray
from slam.common.config import Config
from slam.loop_closure.candidate import Accepted, Candidate, Stage
from slam.loop_closure.closure_graph import ClosedLoops
from slam.object_map.landmarks import ObjectMap
from slam.odometry.keyframe import Keyframe

INSERT_RANGES = 2.0 / 3.0
"""Least travel between two closures that become factors of the graph, in sensor ranges."""
TRUSTED_AFTER_RANGES = 60.0 / 30.0
"""A relocalization that stayed consistent over that travel, in sensor ranges, is taken to be true."""


class AcceptedClosures:
    """Closures in the order in which they were accepted; some are factors, and represent those nearby."""

    def __init__(
        self, config: Config, object_map: ObjectMap, graph: FactorGraph, keyframes: Sequence[Keyframe]
    ) -> None:
        self._propagation_distance_m = config.propagation_distance_m
        self._insert_travel_m = INSERT_RANGES * config.sensor_range_m
        self._trusted_after_m = TRUSTED_AFTER_RANGES * config.sensor_range_m
        self._keyframes = keyframes
        self._loops = ClosedLoops(object_map, graph, keyframes, min_travel_m=config.closure_travel_m)
        self._closed: dict[int, int] = {}
        self._tracked: dict[int, int] = {}
        self._accepted: list[Accepted] = []

    @property
    def keyframes(self) -> IntArray:
        """Query and reference keyframe (C, 2) of each."""
        return np.array(list(self._closed.items()), dtype=np.int64).reshape(-1, 2)

    def is_closed(self, keyframe: int) -> bool:
        """Whether a keyframe is the query of one."""
        return keyframe in self._closed

    def is_localized(self, keyframe: Keyframe) -> bool:
        """Whether odometry or closures connect a keyframe to the first one, and so to the map."""
        return self._loops.are_connected(self._keyframes[0].id, keyframe.id)

    def keyframes_nearby(self) -> set[int]:
        """Localized keyframes within ``propagation_distance_m`` of a closure, or of a place that was recognised by
        landmarks still associated: their positions can be compared.
        """
        ends = np.unique(np.array([*self._closed.items(), *self._tracked.items()], dtype=np.int64))
        segments = np.array([keyframe.odometry.segment for keyframe in self._keyframes])
        near: set[int] = set()
        for segment in np.unique(segments[ends]).tolist():
            members = np.flatnonzero(segments == segment)
            of_segment = [self._keyframes[row] for row in members.tolist()]
            along = np.array([[keyframe.odometry.travel_m] for keyframe in of_segment])
            if of_segment[0].is_prior:  # those have positions and no travel
                along = np.stack([keyframe.T_local_body[:2, 3] for keyframe in of_segment])
            distances_m = cKDTree(along[np.isin(members, ends)]).query(along)[0]
            near.update(members[distances_m <= self._propagation_distance_m].tolist())
        return {row for row in near if self.is_localized(self._keyframes[row])}

    def add(self, candidate: Candidate, reason: str) -> LoopClosureRecord:
        """Accept a closure; it becomes a factor unless one within ``insert_travel_m`` represents it."""
        nearest = self._loops.nearest(candidate.travel_m)
        is_new = nearest is None or (abs(nearest.candidate.travel_m - candidate.travel_m) >= self._insert_travel_m)
        if is_new:
            self._loops.insert(candidate)
        represented_by = (candidate if is_new or nearest is None else nearest.candidate).query.id
        self._accepted.append(Accepted(candidate, represented_by))
        self._closed[candidate.query.id] = candidate.reference.id
        return candidate.record(Stage.ACCEPTED, reason, inserted=is_new, represented_by=represented_by)

    def add_tracked(self, candidate: Candidate) -> None:
        """Remember a place that was recognised by landmarks still associated: there is no loop to close."""
        self._tracked[candidate.query.id] = candidate.reference.id

    def revoke_since(self, keyframe: Keyframe, since: int) -> tuple[list[LoopClosureRecord], bool]:
        """Revoke the closures of a keyframe's segment from the keyframe ``since`` on, which contradict the map.

        If the segment was connected to the map within the last ``TRUSTED_AFTER_RANGES``, that relocalization was false
        and all closures of the segment are revoked; otherwise the robot was kidnapped. Returns the records of the
        revoked closures, and whether the robot was kidnapped.
        """
        segment = keyframe.odometry.segment
        connecting = [
            loop.candidate.travel_m
            for loop in self._loops.loops
            if loop.candidate.crosses_break and loop.candidate.query.odometry.segment == segment
        ]
        connected_m = min(connecting, default=-np.inf)
        is_kidnapped = keyframe.odometry.travel_m - connected_m > self._trusted_after_m
        if not is_kidnapped:
            since = next(each.id for each in self._keyframes if each.odometry.segment == segment)
        self._tracked = {query: reference for query, reference in self._tracked.items() if query < since}
        self._loops.remove([loop for loop in self._loops.loops if loop.candidate.query.id >= since])
        # A closure goes with the factor that represents it, and one that is inconsistent itself goes anyhow.
        revoked = [each for each in self._accepted if each.latest >= since]
        self._accepted = [each for each in self._accepted if each.latest < since]
        for each in revoked:
            self._closed.pop(each.candidate.query.id, None)
        reason = "revoked: expected landmarks not observed"
        return [each.candidate.record(Stage.CONSISTENCY, reason) for each in revoked], is_kidnapped

    def settled_before_m(self, travel_m: float) -> float:
        """Closures before the returned travel are not revoked any more, now that the robot has come to ``travel_m``."""
        trusted_m = travel_m - self._trusted_after_m
        doubtful = any(
            loop.candidate.crosses_break and loop.candidate.travel_m > trusted_m for loop in self._loops.loops
        )
        return -np.inf if doubtful else trusted_m

    def forget_condensed(self) -> None:
        """Forget the closures whose factors were condensed, and those that they represent: they are part of the map."""
        self._loops.forget_condensed()
        factors = {loop.candidate.query.id for loop in self._loops.loops}
        self._accepted = [each for each in self._accepted if each.represented_by in factors]
