"""Loop closing: from a keyframe to accepted loop closures, with a record and a reason for every candidate.

``LoopCloser.close`` is where to begin reading.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from logs.messages import LoopClosureRecord
from slam.backend.factor_graph import FactorGraph
from slam.backend.outlier_rejection import reject_outlier_closures
from slam.common.arrays import FloatArray, IntArray
from slam.common.config import Config
from slam.common.geometry import invert
from slam.loop_closure.candidate import Accepted, Candidate, Query, Stage
from slam.loop_closure.closure_graph import ClosedLoops
from slam.loop_closure.consistency import accumulated_llr, suppress_non_maxima
from slam.loop_closure.divergence_monitor import LocalizationMonitor
from slam.loop_closure.verification import Verifier
from slam.object_map.landmarks import ObjectMap
from slam.object_map.submap import gravity_frame, recent_submap
from slam.odometry.drift import KeyframeTrack
from slam.odometry.keyframe import Keyframe
from slam.place_recognition.retrieval import PlaceRetriever

logger = logging.getLogger(__name__)

IN_VIEW_RANGES = 4.0 / 30.0
"""Landmarks observed within that travel, in sensor ranges, are in view."""
ELSEWHERE_RANGES = 15.0 / 30.0
"""Farther, in sensor ranges, than the odometry can drift between two propagated closures."""
TRUSTED_AFTER_RANGES = 60.0 / 30.0
"""A relocalization that stayed consistent over that travel, in sensor ranges, is taken to be true."""


class LoopCloser:
    """Finds, verifies, accepts and inserts loop closures, keyframe by keyframe."""

    def __init__(
        self, config: Config, object_map: ObjectMap, graph: FactorGraph, keyframes: Sequence[Keyframe]
    ) -> None:
        self._submap_config = config.submap
        self._limits = config.loop_closure
        self._sensor_range_m = config.detection.sensor_range_m
        self._odometry_inflation = config.odometry.inflation
        self._map = object_map
        self._keyframes = keyframes
        self._track = KeyframeTrack(config.odometry)
        for keyframe in keyframes:  # of the prior map
            self._track.add(keyframe)
        self._retriever = PlaceRetriever(config, object_map)
        self._verifier = Verifier(config, self._retriever, self._track, graph, keyframes)
        self._graph = graph
        self._loops = ClosedLoops(object_map, graph, keyframes, min_travel_m=config.loop_closure.min_travel_m)
        self._recent: deque[Query] = deque()
        self._hypotheses: deque[Candidate] = deque()
        self._seed_closure: Candidate | None = None
        self._monitor = LocalizationMonitor(self._sensor_range_m)
        # Only a prior map is trusted more than the robot's pose; a map in the making may itself be wrong.
        self._monitors_localization = any(keyframe.is_prior for keyframe in keyframes)
        self.lost_since_keyframe: int | None = None
        """The first keyframe that is inconsistent with the map, once the robot is lost; None while it is not."""
        self._closed: dict[int, int] = {}
        self._rejected_by_odometry: set[int] = set()
        self._accepted: list[Accepted] = []

    @property
    def closed(self) -> IntArray:
        """Query and reference keyframe (C, 2) of the accepted closures."""
        return np.array(list(self._closed.items()), dtype=np.int64).reshape(-1, 2)

    @property
    def rejected_by_odometry_count(self) -> int:
        """Keyframes with a candidate whose LLR reaches ``accept_llr``, but its odometry penalty is too large."""
        return len(self._rejected_by_odometry - self._closed.keys())

    def is_localized(self, keyframe: Keyframe) -> bool:
        """Whether odometry or closures connect a keyframe to the first one, and so to the map."""
        return self._loops.are_connected(self._keyframes[0].id, keyframe.id)

    def keyframes_near_closures(self) -> set[int]:
        """Localized keyframes within ``propagation_distance_m`` of a closure: their positions can be compared."""
        ends = np.unique(self.closed)
        segments = np.array([keyframe.odometry.segment for keyframe in self._keyframes])
        near: set[int] = set()
        for segment in np.unique(segments[ends]).tolist():
            members = np.flatnonzero(segments == segment)
            of_segment = [self._keyframes[row] for row in members.tolist()]
            along = np.array([[keyframe.odometry.travel_m] for keyframe in of_segment])
            if of_segment[0].is_prior:  # those have positions and no travel
                along = np.stack([keyframe.T_local_body[:2, 3] for keyframe in of_segment])
            distances_m = cKDTree(along[np.isin(members, ends)]).query(along)[0]
            near.update(members[distances_m <= self._limits.propagation_distance_m].tolist())
        return {row for row in near if self.is_localized(self._keyframes[row])}

    def missing_landmarks(self) -> IntArray:
        """Rows (K,) of landmarks that were often expected in view and never observed."""
        return self._monitor.missing()

    def close(self, keyframe: Keyframe) -> list[LoopClosureRecord]:
        """Look for loops at the newest keyframe; returns a record of every candidate, revised ones included."""
        self._track.add(keyframe)
        self._retriever.index_inactive_landmarks(keyframe.odometry.travel_m)
        query = self._take_query(keyframe)
        if self._verifier.latest_m(query) <= self._keyframes[0].odometry.travel_m:
            return []
        if self._is_inconsistent(query):
            self.lost_since_keyframe = self._monitor.inconsistent_since
            return [query.refusal(Stage.CONSISTENCY, "expected landmarks not observed")]
        # 1. Near an accepted closure the pose is predicted, and only verified.
        propagated = self._propagate(query)
        if propagated is not None:
            self._monitor.confirm()
            return [self.accept(propagated, f"propagated from the closure of keyframe {propagated.seed_closure}")]
        # 2. Elsewhere landmarks that are still followed, or retrieval by triangles and descriptors, propose candidates.
        if len(query.submap) < self._limits.min_inliers:
            reason = f"{len(query.submap)} landmarks in the submap, min_inliers is {self._limits.min_inliers}"
            return [query.refusal(Stage.RETRIEVAL, reason)]
        tracked = self._verifier.tracked_place(query) if self._limits.close_tracked else None
        verified = [self._verifier.verify(query, tracked)] if tracked is not None else []
        if not self._any_acceptable(verified):
            places = self._retriever.retrieve(query.submap, before_m=self._verifier.latest_m(query), seed=keyframe.id)
            verified += [self._verifier.verify(query, place) for place in places]
        # 3. If the robot is lost and none of them is acceptable, the whole map is searched.
        if not self.is_localized(keyframe) and not self._any_acceptable(verified):
            places = self._retriever.search_exhaustively(query.submap, segment=self._keyframes[0].odometry.segment)
            verified += [self._verifier.verify(query, place) for place in places]
        if not verified:
            return [query.refusal(Stage.RETRIEVAL, "no matches that agree on a place")]
        # 4. The candidate with the highest score is accepted, kept as a hypothesis or rejected.
        refused = [each for each in verified if isinstance(each, LoopClosureRecord)]
        candidates = suppress_non_maxima(
            [each for each in verified if isinstance(each, Candidate)], sensor_range_m=self._sensor_range_m
        )
        return refused + self._decide(query, candidates)

    def _any_acceptable(self, verified: Sequence[Candidate | LoopClosureRecord]) -> bool:
        """Whether the score of a candidate reaches ``accept_llr``."""
        return any(isinstance(each, Candidate) and each.score >= self._limits.accept_llr for each in verified)

    def declare_lost(self, keyframe: Keyframe, since: int) -> tuple[list[LoopClosureRecord], bool]:
        """Reset to lost and revoke the closures from the keyframe ``since`` on, which are inconsistent with the map.

        If the segment was connected to the map within the last ``TRUSTED_AFTER_RANGES``, that relocalization was false
        and all closures of the segment are revoked; otherwise the robot was kidnapped. Returns the records of the
        revoked closures, and whether it was kidnapped.
        """
        connecting = [
            loop.candidate.travel_m
            for loop in self._loops.loops
            if self._crosses_break(loop.candidate)
            and self._keyframes[loop.candidate.query].odometry.segment == keyframe.odometry.segment
        ]
        connected_m = min(connecting, default=-np.inf)
        is_kidnapped = keyframe.odometry.travel_m - connected_m > TRUSTED_AFTER_RANGES * self._sensor_range_m
        if not is_kidnapped:
            since = next(k.id for k in self._keyframes if k.odometry.segment == keyframe.odometry.segment)
        self._loops.remove([loop for loop in self._loops.loops if loop.candidate.query >= since])
        # A closure goes with the factor that represents it, and one that is inconsistent itself goes anyhow.
        revoked = self._revoke(lambda each: max(each.candidate.query, each.represented_by) >= since)
        self.lost_since_keyframe = None
        self._monitor.restart()
        self._seed_closure = None
        self._hypotheses.clear()
        self._recent.clear()
        reason = "revoked: expected landmarks not observed"
        return [each.candidate.record(Stage.CONSISTENCY, reason) for each in revoked], is_kidnapped

    def finish(self) -> tuple[list[LoopClosureRecord], str]:
        """Remove the closures that the robust optimisation of the pose graph rejects as outliers.

        Closures across a discontinuity of the odometry are kept: without them nothing relates the two segments.
        Returns the records of the removed closures and a warning, empty if there is none.
        """
        loops = {loop.factor: loop for loop in self._loops.loops if not self._crosses_break(loop.candidate)}
        if not loops:
            return [], ""
        graph = self._graph
        rejection = reject_outlier_closures(
            graph.factors,
            list(loops),
            graph.keyframes,
            graph.poses(),
            odometry_inflation=self._odometry_inflation,
        )
        reasons = {
            loop.candidate.query: f"removed as an outlier: kernel weight {rejection.weights[factor]:.2g}"
            for factor, loop in loops.items()
            if not rejection.kept[factor]
        }
        self._loops.remove([loop for loop in loops.values() if loop.candidate.query in reasons])
        removed = self._revoke(lambda each: each.represented_by in reasons)
        records = [each.candidate.record(Stage.BACK_END, reasons[each.represented_by]) for each in removed]
        return records, rejection.message

    def _revoke(self, is_revoked: Callable[[Accepted], bool]) -> list[Accepted]:
        """Take accepted closures back; their factors are removed elsewhere."""
        revoked = [each for each in self._accepted if is_revoked(each)]
        self._accepted = [each for each in self._accepted if not is_revoked(each)]
        for each in revoked:
            self._closed.pop(each.candidate.query, None)
        return revoked

    def _crosses_break(self, candidate: Candidate) -> bool:
        reference, query = self._keyframes[candidate.reference], self._keyframes[candidate.query]
        return reference.odometry.segment != query.odometry.segment

    def _take_query(self, keyframe: Keyframe) -> Query:
        submap = recent_submap(self._map, keyframe, self._submap_config)
        query = Query(keyframe, submap, gravity_frame(keyframe.T_local_body))
        oldest_m = query.travel_m - self._limits.propagation_distance_m
        self._recent.append(query)
        while self._recent[0].travel_m < oldest_m:
            self._recent.popleft()
        while self._hypotheses and self._hypotheses[0].travel_m < oldest_m:
            self._hypotheses.popleft()
        return query

    def _propagate(self, query: Query) -> Candidate | None:
        """The closure that the last one predicts; None where it cannot be verified."""
        seed_closure = self._recent_seed(query)
        return None if seed_closure is None else self._verify_propagated(seed_closure, query)

    def _recent_seed(self, query: Query) -> Candidate | None:
        """The last closure, if it is near enough to predict the pose of the query."""
        seed_closure = self._seed_closure
        if seed_closure is None or query.travel_m - seed_closure.travel_m > self._limits.propagation_distance_m:
            return None
        return seed_closure

    def _is_inconsistent(self, query: Query) -> bool:
        """Whether the observations contradict the map at the pose that the last closure predicts."""
        seed_closure = self._recent_seed(query)
        if not self._monitors_localization or seed_closure is None:
            self._monitor.restart()
            return False
        place = self._verifier.predict(seed_closure, query)
        if place is None:
            return False
        reference = self._retriever.reference_submap(place, before_m=self._verifier.latest_m(query))
        seen_m = self._map.rows["last_seen_travel_m"][query.submap.rows]
        observed = query.submap.of(np.flatnonzero(seen_m > query.travel_m - IN_VIEW_RANGES * self._sensor_range_m))
        return self._monitor.update(query.keyframe.id, observed, reference, place.T_local_query)

    def _is_elsewhere(self, query: Query, candidate: Candidate) -> bool:
        """Whether a candidate is far from the pose that the last closure, if it is recent, predicts."""
        seed_closure = self._recent_seed(query)
        if not self._monitors_localization or seed_closure is None:
            return False
        place = self._verifier.predict(seed_closure, query)
        if place is None or place.segment != self._keyframes[candidate.reference].odometry.segment:
            return False
        apart_m = float(np.linalg.norm((place.T_local_query - candidate.T_local_query)[:2, 3]))
        return apart_m > ELSEWHERE_RANGES * self._sensor_range_m

    def _verify_propagated(self, seed_closure: Candidate, query: Query) -> Candidate | None:
        """The closure that ``seed_closure`` predicts for a query, if the LLR reaches ``accept_llr_tracked``."""
        place = self._verifier.predict(seed_closure, query)
        if place is None:
            return None
        candidate = self._verifier.verify(query, place, seed_closure=seed_closure.query)
        if not isinstance(candidate, Candidate) or not self._verifier.agree(
            candidate.T_local_query, place.T_local_query
        ):
            return None
        return candidate if candidate.log_likelihood_ratio >= self._limits.accept_llr_tracked else None

    def _decide(self, query: Query, candidates: list[Candidate]) -> list[LoopClosureRecord]:
        """Records of the candidates of one query, given by falling score."""
        if not candidates:
            return []
        best, others = candidates[0], candidates[1:]
        records = [each.record(Stage.ACCEPTANCE, "another candidate has a higher score") for each in others]
        rivals = [each for each in others if not self._verifier.are_consistent(best, each)]
        rival_score = max((each.score for each in rivals), default=0.0)
        best = replace(best, best_rival_llr=max((each.log_likelihood_ratio for each in rivals), default=None))
        if best.score < self._limits.accept_llr:
            return records + self._accumulate(query, best)
        best, ambiguity = self._ambiguity(query, best, rival_score)
        if ambiguity:
            return [*records, best.record(Stage.ACCEPTANCE, ambiguity)]
        if self._is_elsewhere(query, best):
            since = self._monitor.inconsistent_since if self._monitor.is_inconsistent else None
            self.lost_since_keyframe = query.keyframe.id if since is None else since
            return [*records, best.record(Stage.CONSISTENCY, "contradicts the odometry: kidnapped")]
        return [*records, *self._accept_and_propagate(best, "")]

    def _ambiguity(self, query: Query, candidate: Candidate, rival_score: float) -> tuple[Candidate, str]:
        """The candidate with the LLR of its best rival, and why it is ambiguous; empty if it is not."""
        if candidate.score - rival_score < self._limits.ambiguity_margin:
            return candidate, f"ambiguous: score {candidate.score:.1f}, second best {rival_score:.1f}"
        shifted_llr = self._verifier.max_llr_along_track(query, candidate)
        rival_llr = -np.inf if candidate.best_rival_llr is None else candidate.best_rival_llr
        compared = replace(candidate, best_rival_llr=max(rival_llr, shifted_llr))
        if candidate.log_likelihood_ratio - shifted_llr < self._limits.ambiguity_margin:
            llr = candidate.log_likelihood_ratio
            return compared, f"ambiguous along track: LLR {llr:.1f}, shifted {shifted_llr:.1f}"
        alias_score = self._verifier.max_score_of_aliases(query, candidate)
        if candidate.score - alias_score < self._limits.ambiguity_margin:
            return compared, f"ambiguous pattern: score {candidate.score:.1f}, repeated {alias_score:.1f}"
        return compared, ""

    def _accumulate(self, query: Query, candidate: Candidate) -> list[LoopClosureRecord]:
        """Records of a candidate below ``accept_llr``, which is accepted together with earlier ones that agree."""
        llr, limits = candidate.log_likelihood_ratio, self._limits
        values = f"LLR {llr:.1f}, odometry penalty {candidate.odometry_penalty:.1f}"
        if llr < limits.hypothesis_llr:
            return [candidate.record(Stage.ACCEPTANCE, f"{values}: hypothesis_llr is {limits.hypothesis_llr:g}")]
        agreeing = [
            each
            for each in self._hypotheses
            if self._verifier.agree(self._carried(each, candidate), candidate.T_local_query)
        ]
        joint_score = accumulated_llr([*agreeing, candidate])
        candidate = replace(candidate, accumulated_llr=joint_score)
        if joint_score < limits.accept_llr:
            self._hypotheses.append(candidate)
            if llr >= limits.accept_llr:
                self._rejected_by_odometry.add(candidate.query)
            reason = f"{values}: accumulated score {joint_score:.1f}, accept_llr is {limits.accept_llr:g}"
            return [candidate.record(Stage.CONSISTENCY, reason)]
        candidate, ambiguity = self._ambiguity(query, candidate, -np.inf)
        if ambiguity:
            return [candidate.record(Stage.ACCEPTANCE, ambiguity)]
        self._hypotheses = deque(each for each in self._hypotheses if each not in agreeing)
        reason = f"accumulated score {joint_score:.1f} with {len(agreeing)} other keyframes"
        accepted = [replace(each, accumulated_llr=joint_score) for each in agreeing]
        return [*(self.accept(each, reason) for each in accepted), *self._accept_and_propagate(candidate, reason)]

    def _carried(self, earlier: Candidate, later: Candidate) -> FloatArray:
        """``T_local_query`` (4, 4) of a later candidate's query as an earlier candidate predicts it."""
        before = self._keyframes[earlier.query].T_local_body
        after = self._keyframes[later.query].T_local_body
        return earlier.T_local_query @ invert(gravity_frame(before)) @ gravity_frame(after)

    def _accept_and_propagate(self, candidate: Candidate, reason: str) -> list[LoopClosureRecord]:
        """Accept a retrieved closure, and those that it predicts for the keyframes before it and that are verified."""
        logger.info(
            "closed a loop: keyframe %d is at keyframe %d (score %.1f)",
            candidate.query,
            candidate.reference,
            candidate.score,
        )
        records = [self.accept(candidate, reason)]
        seed_closure = candidate
        for query in reversed(self._recent):
            if query.keyframe.id >= candidate.query or query.keyframe.id in self._closed:
                continue
            propagated = self._verify_propagated(seed_closure, query)
            if propagated is not None:
                records.append(self.accept(propagated, f"propagated from the closure of keyframe {seed_closure.query}"))
                seed_closure = propagated
        self._seed_closure = candidate
        return records

    def accept(self, candidate: Candidate, reason: str) -> LoopClosureRecord:
        """Accept a closure; it becomes a factor unless one within ``insert_travel_m`` represents it."""
        nearest = self._loops.nearest(candidate.travel_m)
        is_new = nearest is None or (
            abs(nearest.candidate.travel_m - candidate.travel_m) >= self._limits.insert_travel_m
        )
        if is_new:
            self._loops.insert(candidate)
        represented_by = candidate.query if is_new or nearest is None else nearest.candidate.query
        self._accepted.append(Accepted(candidate, represented_by))
        self._closed[candidate.query] = candidate.reference
        self._seed_closure = candidate
        return candidate.record(Stage.ACCEPTED, reason, inserted=is_new, represented_by=represented_by)
