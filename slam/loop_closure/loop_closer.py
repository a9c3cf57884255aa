"""Loop closing: from a keyframe to the closures that are believed, with a verdict on every candidate.

``LoopCloser.close`` is where to begin reading.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from logs.messages import LoopClosureRecord
from slam.backend.factor_graph import FactorGraph
from slam.backend.outlier_rejection import judge_closures
from slam.common.arrays import FloatArray, IntArray
from slam.common.config import Config
from slam.common.geometry import invert
from slam.loop_closure.candidate import Candidate, Query, Stage
from slam.loop_closure.closure_graph import ClosedLoops
from slam.loop_closure.consistency import agree, distinct, joint_score_nats
from slam.loop_closure.divergence_monitor import PlaceWatch
from slam.loop_closure.verification import Verifier
from slam.object_map.landmarks import ObjectMap
from slam.object_map.submap import gravity_frame, recent_submap
from slam.odometry.drift import KeyframeTrack
from slam.odometry.keyframe import Keyframe
from slam.place_recognition.retrieval import PlaceFinder

logger = logging.getLogger(__name__)

IN_VIEW_M = 4.0
"""What was seen within that travel is in view."""
ELSEWHERE_M = 15.0
"""Farther than the odometry can drift while closures follow one another."""
TRUSTED_AFTER_M = 60.0
"""A place that was not contradicted for that long after it was recognised was right."""


class LoopCloser:
    """Finds, judges and inserts loop closures, keyframe by keyframe."""

    def __init__(
        self, config: Config, object_map: ObjectMap, graph: FactorGraph, keyframes: Sequence[Keyframe]
    ) -> None:
        self._submap_config = config.submap
        self._limits = config.loop_closure
        self._map = object_map
        self._keyframes = keyframes
        self._track = KeyframeTrack(config.odometry)
        for keyframe in keyframes:  # of an earlier drive
            self._track.add(keyframe.odometry)
        self._finder = PlaceFinder(config.loop_closure, config.submap, config.registration, object_map)
        self._verifier = Verifier(config, self._finder, self._track, graph, keyframes)
        self._graph = graph
        self._loops = ClosedLoops(object_map, graph, keyframes)
        self._recent: deque[Query] = deque()
        self._waiting: deque[Candidate] = deque()
        self._leader: Candidate | None = None
        self._watch = PlaceWatch()
        # A map that is only being made may itself be wrong where it contradicts; one that was given is not.
        self._watches = len(keyframes) > 0
        self.lost_since: int = -1
        """The first of the keyframes that contradict where the robot is believed to be, if it is time to give up."""
        self._closed: dict[int, int] = {}
        self._doubted: set[int] = set()
        self._believed: list[tuple[Candidate, int]] = []
        """With the query of the closure that became a factor, its own or the one that says the same."""

    @property
    def closed(self) -> IntArray:
        """Query and reference keyframe (C, 2) of the closures that are believed."""
        return np.array(list(self._closed.items()), dtype=np.int64).reshape(-1, 2)

    @property
    def doubted_count(self) -> int:
        """Keyframes whose objects say that they are at a place, but the odometry's noise does not allow it."""
        return len(self._doubted - self._closed.keys())

    def knows_where(self, keyframe: Keyframe) -> bool:
        """Whether odometry or closures tie a keyframe to the first one, and so to the map."""
        return self._loops.are_joined(self._keyframes[0].id, keyframe.id)

    def keyframes_near_closures(self) -> set[int]:
        """Those, tied to the map, that closures hold so near to where they were before that places can be compared."""
        ends = np.unique(self.closed)
        segments = np.array([keyframe.odometry.segment for keyframe in self._keyframes])
        near: set[int] = set()
        for segment in np.unique(segments[ends]).tolist():
            members = np.flatnonzero(segments == segment)
            along = np.array([[self._keyframes[row].odometry.travel_m] for row in members.tolist()])
            if np.ptp(along) == 0.0:  # a map that was given: it has places and no travel
                along = np.stack([self._keyframes[row].odometry.T_odom_body[:2, 3] for row in members.tolist()])
            distances_m = cKDTree(along[np.isin(members, ends)]).query(along)[0]
            near.update(members[distances_m <= self._limits.follow_travel_m].tolist())
        return {row for row in near if self.knows_where(self._keyframes[row])}

    def missing_landmarks(self) -> IntArray:
        """Rows (K,) of landmarks that were looked for where they stood, often, and never seen again."""
        return self._watch.missing()

    def close(self, keyframe: Keyframe) -> list[LoopClosureRecord]:
        """Look for loops at the newest keyframe; returns every candidate with its verdict, revised ones included."""
        self._track.add(keyframe.odometry)
        self._finder.settle(keyframe.odometry.travel_m)
        query = self._take_query(keyframe)
        if self._verifier.latest_m(query) <= self._keyframes[0].odometry.travel_m:
            return []
        if self._contradicts(query):
            self.lost_since = self._watch.doubted_since
            return [query.refusal(Stage.CONSISTENCY, "other objects are seen than stand where the robot should be")]
        # 1. Next to a closure that is believed the place is known, and only to be verified.
        followed = self._follow(query)
        if followed is not None:
            self._watch.confirm()
            return [self._believe(followed, f"follows the closure of keyframe {followed.leader}")]
        # 2. Elsewhere descriptors propose places.
        if len(query.submap) < self._limits.min_objects:
            return [query.refusal(Stage.RETRIEVAL, f"only {len(query.submap)} objects in view")]
        places = self._finder.find(query.submap, before_m=self._verifier.latest_m(query), seed=keyframe.id)
        verified = [self._verifier.verify(query, place) for place in places]
        # 3. One who is lost, and not found by them, tries all places.
        if not self.knows_where(keyframe) and not self._is_convincing(verified):
            places = self._finder.find_anywhere(query.submap, segment=self._keyframes[0].odometry.segment)
            verified += [self._verifier.verify(query, place) for place in places]
        if not verified:
            return [query.refusal(Stage.RETRIEVAL, "no descriptors that agree on a place")]
        # 4. Each place was registered and weighed, and the best one is judged.
        refused = [each for each in verified if isinstance(each, LoopClosureRecord)]
        candidates = distinct([each for each in verified if isinstance(each, Candidate)])
        return refused + self._judge(query, candidates)

    def _is_convincing(self, verified: Sequence[Candidate | LoopClosureRecord]) -> bool:
        """Whether one of the candidates is enough by itself."""
        return any(isinstance(each, Candidate) and each.score_nats >= self._limits.threshold_nats for each in verified)

    def give_up(self, keyframe: Keyframe) -> tuple[list[LoopClosureRecord], bool]:
        """Begin anew after the place was contradicted; what was closed since then is taken back.

        Where the sessions had been joined only just before, joining them was wrong, and is taken back, too; else the
        robot was carried off. Returns the new verdicts, and whether it was carried off.
        """
        joining = [
            loop.candidate.travel_m
            for loop in self._loops.loops
            if self._crosses_break(loop.candidate)
            and self._keyframes[loop.candidate.query].odometry.segment == keyframe.odometry.segment
        ]
        joined_m = min(joining, default=-np.inf)
        is_carried_off = keyframe.odometry.travel_m - joined_m > TRUSTED_AFTER_M
        since = self.lost_since
        if not is_carried_off:
            since = next(k.id for k in self._keyframes if k.odometry.segment == keyframe.odometry.segment)
        self._loops.withdraw([loop for loop in self._loops.loops if loop.candidate.query >= since])
        gone = [each for each, _ in self._believed if each.query >= since]
        self._believed = [each for each in self._believed if each[0].query < since]
        for candidate in gone:
            self._closed.pop(candidate.query, None)
        self.lost_since = -1
        self._watch.restart()
        self._leader = None
        self._waiting.clear()
        self._recent.clear()
        reason = "taken back: other objects were seen than stand there"
        return [candidate.record(Stage.CONSISTENCY, reason) for candidate in gone], is_carried_off

    def finish(self) -> tuple[list[LoopClosureRecord], str]:
        """Take out the closures that all factors together contradict; returns their new verdicts and a message.

        Those across a break of the odometry are left: nothing but closures says where its two sides are.
        """
        loops = {loop.factor: loop for loop in self._loops.loops if not self._crosses_break(loop.candidate)}
        if not loops:
            return [], ""
        graph = self._graph
        judgement = judge_closures(
            graph.factors,
            list(loops),
            graph.keyframes,
            graph.poses(),
            odometry_inflation=self._limits.odometry_inflation,
        )
        reasons = {
            loop.candidate.query: f"taken out again: weight {judgement.weights[factor]:.2g} among all factors"
            for factor, loop in loops.items()
            if not judgement.kept[factor]
        }
        self._loops.withdraw([loop for loop in loops.values() if loop.candidate.query in reasons])
        gone = [(each, reasons[factor]) for each, factor in self._believed if factor in reasons]
        for candidate, _ in gone:
            self._closed.pop(candidate.query, None)
        return [candidate.record(Stage.BACK_END, reason) for candidate, reason in gone], judgement.message

    def _crosses_break(self, candidate: Candidate) -> bool:
        reference, query = self._keyframes[candidate.reference], self._keyframes[candidate.query]
        return reference.odometry.segment != query.odometry.segment

    def _take_query(self, keyframe: Keyframe) -> Query:
        submap = recent_submap(self._map, keyframe.odometry, self._submap_config)
        query = Query(keyframe, submap, gravity_frame(keyframe.odometry.T_odom_body))
        oldest_m = query.travel_m - self._limits.follow_travel_m
        self._recent.append(query)
        while self._recent[0].travel_m < oldest_m:
            self._recent.popleft()
        while self._waiting and self._waiting[0].travel_m < oldest_m:
            self._waiting.popleft()
        return query

    def _follow(self, query: Query) -> Candidate | None:
        """The closure that the last one predicts; None where it cannot be verified."""
        leader = self._recent_leader(query)
        return None if leader is None else self._supported(leader, query)

    def _recent_leader(self, query: Query) -> Candidate | None:
        """The last closure, if it is near enough to tell where the query is."""
        leader = self._leader
        if leader is None or query.travel_m - leader.travel_m > self._limits.follow_travel_m:
            return None
        return leader

    def _contradicts(self, query: Query) -> bool:
        """Whether the query, where the last closure puts it, has gone on seeing other things for too long."""
        leader = self._recent_leader(query)
        if not self._watches or leader is None:
            self._watch.restart()
            return False
        place = self._verifier.predict(leader, query)
        if place is None:
            return False
        around = self._finder.surroundings(place, before_m=self._verifier.latest_m(query))
        seen_m = self._map.rows["last_seen_travel_m"][query.submap.rows]
        seen = query.submap.of(np.flatnonzero(seen_m > query.travel_m - IN_VIEW_M))
        return self._watch.look(query.keyframe.id, seen, around, place.T_odom_query)

    def _is_elsewhere(self, query: Query, candidate: Candidate) -> bool:
        """Whether a candidate is far from where the last closure, not long ago, puts the query."""
        leader = self._recent_leader(query)
        if not self._watches or leader is None:
            return False
        place = self._verifier.predict(leader, query)
        if place is None or place.segment != self._keyframes[candidate.reference].odometry.segment:
            return False
        return float(np.linalg.norm((place.T_odom_query - candidate.T_odom_query)[:2, 3])) > ELSEWHERE_M

    def _supported(self, leader: Candidate, query: Query) -> Candidate | None:
        """The closure that one nearby predicts for a query, if the query's own objects bear it out."""
        place = self._verifier.predict(leader, query)
        if place is None:
            return None
        candidate = self._verifier.verify(query, place, leader=leader.query)
        if not isinstance(candidate, Candidate) or not agree(candidate.T_odom_query, place.T_odom_query):
            return None
        return candidate if candidate.evidence_nats >= self._limits.supported_nats else None

    def _judge(self, query: Query, candidates: list[Candidate]) -> list[LoopClosureRecord]:
        """Verdicts on the candidates of one query, best first."""
        if not candidates:
            return []
        best, others = candidates[0], candidates[1:]
        verdicts = [each.record(Stage.ACCEPTANCE, "another place is likelier") for each in others]
        rivals = [each for each in others if not self._verifier.can_both_hold(best, each)]
        rival_nats = max((each.score_nats for each in rivals), default=0.0)
        if best.score_nats < self._limits.threshold_nats:
            return verdicts + self._wait(query, best)
        ambiguity = self._ambiguity(query, best, rival_nats)
        if ambiguity:
            return [*verdicts, best.record(Stage.ACCEPTANCE, ambiguity)]
        if self._is_elsewhere(query, best):
            self.lost_since = self._watch.doubted_since if self._watch.doubts else query.keyframe.id
            return [*verdicts, best.record(Stage.CONSISTENCY, "the odometry cannot have come here: carried off")]
        return [*verdicts, *self._believe_first(best, "")]

    def _ambiguity(self, query: Query, candidate: Candidate, rival_nats: float) -> str:
        """Why a candidate might as well be elsewhere; empty if it might not."""
        if candidate.score_nats - rival_nats < self._limits.margin_nats:
            return f"another place is as likely: {candidate.score_nats:.1f} against {rival_nats:.1f} nats"
        slid_nats = self._verifier.rival_along_the_street(query, candidate)
        if candidate.evidence_nats - slid_nats < self._limits.margin_nats:
            return f"it fits as well further along: {candidate.evidence_nats:.1f} against {slid_nats:.1f} nats"
        return ""

    def _wait(self, query: Query, candidate: Candidate) -> list[LoopClosureRecord]:
        """Verdict on a candidate that is not enough by itself: earlier ones may agree with it."""
        said = f"evidence {candidate.evidence_nats:.1f}, doubt {candidate.doubt_nats:.1f}"
        if candidate.evidence_nats < self._limits.waiting_nats:
            return [candidate.record(Stage.ACCEPTANCE, f"{said}: below {self._limits.waiting_nats:g} nats")]
        agreeing = [each for each in self._waiting if agree(self._carried(each, candidate), candidate.T_odom_query)]
        together = joint_score_nats([*agreeing, candidate])
        threshold = self._limits.threshold_nats
        if together < threshold:
            self._waiting.append(candidate)
            if candidate.evidence_nats >= threshold:
                self._doubted.add(candidate.query)
            reason = f"{said}: waits for others that agree, {together:.1f} of {threshold:g} nats so far"
            return [candidate.record(Stage.CONSISTENCY, reason)]
        ambiguity = self._ambiguity(query, candidate, -np.inf)
        if ambiguity:
            return [candidate.record(Stage.ACCEPTANCE, ambiguity)]
        self._waiting = deque(each for each in self._waiting if each not in agreeing)
        reason = f"{together:.1f} nats together with those of {len(agreeing)} other keyframes"
        return [*(self._believe(each, reason) for each in agreeing), *self._believe_first(candidate, reason)]

    def _carried(self, earlier: Candidate, later: Candidate) -> FloatArray:
        """``T_odom_query`` (4, 4) of a later candidate's query, as the earlier one has it."""
        before = self._keyframes[earlier.query].odometry.T_odom_body
        after = self._keyframes[later.query].odometry.T_odom_body
        return earlier.T_odom_query @ invert(gravity_frame(before)) @ gravity_frame(after)

    def _believe_first(self, candidate: Candidate, reason: str) -> list[LoopClosureRecord]:
        """Believe a closure that descriptors found, and those of the keyframes before it that it bears out."""
        logger.info(
            "closed a loop: keyframe %d is at keyframe %d (%.1f nats)",
            candidate.query,
            candidate.reference,
            candidate.score_nats,
        )
        verdicts = [self._believe(candidate, reason)]
        leader = candidate
        for query in reversed(self._recent):
            if query.keyframe.id >= candidate.query or query.keyframe.id in self._closed:
                continue
            earlier = self._supported(leader, query)
            if earlier is not None:
                verdicts.append(self._believe(earlier, f"leads to the closure of keyframe {leader.query}"))
                leader = earlier
        self._leader = candidate
        return verdicts

    def _believe(self, candidate: Candidate, reason: str) -> LoopClosureRecord:
        """Accept a closure; it becomes a factor unless one nearby says the same."""
        nearest = self._loops.nearest(candidate.travel_m)
        is_new = nearest is None or (
            abs(nearest.candidate.travel_m - candidate.travel_m) >= self._limits.insert_travel_m
        )
        if is_new:
            self._loops.insert(candidate)
        self._believed.append((candidate, candidate.query if is_new or nearest is None else nearest.candidate.query))
        self._closed[candidate.query] = candidate.reference
        self._leader = candidate
        return candidate.record(Stage.ACCEPTED, reason, inserted=is_new)
