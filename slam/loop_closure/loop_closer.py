"""Loop closing: from a keyframe to accepted loop closures, with a record and a reason for every candidate.

``LoopCloser.close`` is where to begin reading: places are proposed, by an accepted closure or by retrieval, a candidate
is registered at each of them, and its posterior probability decides.
"""

import logging
from bisect import bisect_left
from collections import deque
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from logs.closures import Stage
from logs.messages import LoopClosureRecord
from logs.records import frozen
from slam.backend.factor_graph import FactorGraph
from slam.common.config import Config
from slam.common.geometry import gravity_frame, invert
from slam.localization.continuity_monitor import ContinuityMonitor
from slam.loop_closure.acceptance import Acceptance
from slam.loop_closure.accepted_closures import AcceptedClosures
from slam.loop_closure.candidate import Candidate, Query, Verified
from slam.loop_closure.likelihood_ratio import changed_log_likelihood_ratio
from slam.loop_closure.verification import Verifier
from slam.object_map.landmarks import ObjectMap
from slam.object_map.submap import recent_submap, recent_submap_with_unconfirmed
from slam.odometry.keyframe import Keyframe
from slam.place_recognition.imported_places import SEGMENT, ImportedPlaces
from slam.place_recognition.initial_pose import InitialPose
from slam.place_recognition.place_search import Place
from slam.place_recognition.retrieval import PlaceRetriever
from slam.registration.registration import MIN_INLIERS

logger = logging.getLogger(__name__)


@frozen
class Outcome:
    """What a keyframe found: ``records`` of all candidates, revised ones included; ``lost_after_m``: the travel after
    which the robot is inconsistent with the map, None if it is not.
    """

    records: list[LoopClosureRecord]
    lost_after_m: float | None = None


@frozen
class Predicted:
    """The place of a query that an accepted closure predicts, and the candidate there, or why there is none."""

    place: Place
    verified: Verified


class LoopCloser:
    """Finds, verifies, accepts and inserts loop closures, keyframe by keyframe."""

    def __init__(
        self,
        config: Config,
        object_map: ObjectMap,
        graph: FactorGraph,
        keyframes: Sequence[Keyframe],
        imported: ImportedPlaces | None = None,
    ) -> None:
        self._config = config
        self._sensor_range_m = config.sensor_range_m
        self._map = object_map
        self._keyframes = keyframes
        self._retriever = PlaceRetriever(config, object_map, imported)
        mapped = [] if imported is None else [imported.positions]
        self._verifier = Verifier(config, self._retriever, keyframes, graph.pose, graph.observed_positions, mapped)
        self._acceptance = Acceptance(config, self._verifier)
        self.closures = AcceptedClosures(config, object_map, graph, keyframes)
        self.continuity = ContinuityMonitor(config.localization, config.sensor_range_m)
        # Only a prior map is trusted more than the robot's pose; a map in the making may itself be wrong.
        self._has_prior_map = any(keyframe.is_prior for keyframe in keyframes)
        self._seed: Candidate | None = None  # the last accepted closure, which predicts the next ones
        self._recent: deque[Query] = deque()  # those that a closure may predict
        self._looked_up: Query | None = None
        self.initial_pose: InitialPose | None = None
        """Where in the prior map the robot is said to be; places elsewhere in it are left out."""

    def close(self, keyframe: Keyframe) -> Outcome:
        """Look for loops at the newest keyframe."""
        self._verifier.track.add(keyframe)
        self._retriever.index_inactive_landmarks(keyframe.odometry)
        query = self._take_query(keyframe)
        kidnapped_after_m = self.continuity.update(keyframe, self._map)
        if kidnapped_after_m is not None:
            reason = "kidnapped: other landmarks are in view than a moment ago"
            return Outcome([query.refusal(Stage.CONSISTENCY, reason)], kidnapped_after_m)
        if query.before_m < self._keyframes[0].odometry.travel_m:
            return Outcome([])
        # 1. Near an accepted closure the pose is predicted, and only verified.
        predicted = self._predict(self._seed, query)
        if self._has_prior_map and predicted is not None and self._is_contradicted(query, predicted):
            record = query.refusal(Stage.CONSISTENCY, "expected landmarks not observed")
            return Outcome([record], query.keyframe.odometry.travel_m - self._sensor_range_m)
        if (propagated := self._confirmed(predicted)) is not None:
            self._seed = propagated
            return Outcome([self.closures.add(propagated)])
        # 2. Elsewhere retrieval proposes places.
        if (alike := self._looked_up_alike(query)) is not None:
            refusal = query.refusal(Stage.REPEATED, f"landmarks are those of keyframe {alike.keyframe.id}")
            return Outcome([refusal])
        self._looked_up = query
        # 3. The candidate with the highest score is accepted or rejected.
        decision = self._acceptance.decide(*self._look_up(query))
        records, best = [*decision.rejected], decision.accepted
        if best is None:
            return Outcome(records)
        if self._has_prior_map and predicted is not None and self._is_elsewhere(predicted, best):
            records.append(best.record(Stage.CONSISTENCY, "contradicts the odometry: kidnapped"))
            return Outcome(records, self._keyframes[keyframe.id - 1].odometry.travel_m)
        return Outcome([*records, *self._accept_with_those_before(best)])

    def declare_lost(self, keyframe: Keyframe, since: int) -> tuple[list[LoopClosureRecord], bool]:
        """Forget where the robot is, and revoke the closures from the keyframe ``since`` on.

        Returns the records of the revoked closures, and whether the robot was kidnapped; see
        :meth:`slam.loop_closure.accepted_closures.AcceptedClosures.revoke_since`.
        """
        self._seed = self._looked_up = None
        self._recent.clear()
        self.continuity.restart()
        return self.closures.revoke_since(keyframe, since)

    def begin_segment(self, first: int) -> None:
        """Follow the keyframes from ``first`` on to a segment of their own."""
        self._verifier.track.replace_since(self._keyframes[first:])

    def _take_query(self, keyframe: Keyframe) -> Query:
        """The query of the newest keyframe, which later closures may predict."""
        pose = keyframe.odometry
        first = bisect_left(self._keyframes, pose.segment, key=lambda each: each.odometry.segment)
        # All of earlier segments may be the reference.
        began_m = self._keyframes[first].odometry.travel_m if first else -np.inf
        before_m = max(pose.travel_m - self._config.closure_travel_m, began_m)
        around = recent_submap(self._map, keyframe, self._config.calibration)
        # Those of an earlier traversal that are still associated would match themselves.
        is_new = self._map.rows["first_seen_travel_m"][around.rows] >= before_m
        query = Query(keyframe, around.of(is_new), gravity_frame(keyframe.T_local_body), before_m)
        self._recent.append(query)
        while self._recent[0].keyframe.odometry.travel_m < pose.travel_m - self._config.propagation_distance_m:
            self._recent.popleft()
        return query

    def _predict(self, seed: Candidate | None, query: Query) -> Predicted | None:
        """What a closure predicts for a query; None without one that is near enough."""
        if seed is None:
            return None
        apart_m = abs(query.keyframe.odometry.travel_m - seed.query.odometry.travel_m)
        if apart_m > self._config.propagation_distance_m:
            return None
        place = self._verifier.predict(seed, query)
        return None if place is None else Predicted(place, self._verifier.verify(query, place))

    def _confirmed(self, predicted: Predicted | None) -> Candidate | None:
        """The closure at a predicted place, if it is accepted there."""
        if predicted is None or not isinstance(predicted.verified, Candidate):
            return None
        candidate = predicted.verified
        agrees = candidate.agrees(predicted.place.T_local_query, self._sensor_range_m)
        return candidate if agrees and self._acceptance.is_acceptable(candidate) else None

    def _is_contradicted(self, query: Query, predicted: Predicted) -> bool:
        """Whether landmarks that came into view on the last sensor range of travel make a predicted place less likely
        than a failure of the odometry there.
        """
        if isinstance(predicted.verified, Candidate):
            ratios = predicted.verified.log_likelihood_ratios
        else:
            ratios = self._verifier.unmatched(query, predicted.place)
        landmarks = self._map.rows[query.submap.rows]
        is_old = (landmarks["segment"] == query.keyframe.odometry.segment) & (
            landmarks["first_seen_travel_m"] <= query.keyframe.odometry.travel_m - self._sensor_range_m
        )
        failed = self._config.localization.failure_probability(self._sensor_range_m)
        return bool(changed_log_likelihood_ratio(ratios[~is_old]) < np.log(failed))

    def _is_elsewhere(self, predicted: Predicted, candidate: Candidate) -> bool:
        """Whether a candidate is farther than registration reaches from a predicted place."""
        if predicted.place.segment != candidate.reference.odometry.segment:
            return False
        apart_m = float(np.linalg.norm((predicted.place.T_local_query - candidate.T_local_query)[:2, 3]))
        return apart_m > self._verifier.reach_m

    def _looked_up_alike(self, query: Query) -> Query | None:
        """The last query that was looked up, if the answer is the same, as four fifths of the landmarks are; a closure
        soon after predicts this one, too.
        """
        last = self._looked_up
        if last is None or len(query.submap) < MIN_INLIERS or not self.closures.is_localized(query.keyframe):
            return None
        common = len(np.intersect1d(query.submap.rows, last.submap.rows, assume_unique=True))
        all_of_both = len(query.submap) + len(last.submap) - common
        is_alike = common > 0.8 * all_of_both
        since_m = query.keyframe.odometry.travel_m - last.keyframe.odometry.travel_m
        return last if is_alike and since_m < self._config.propagation_distance_m else None

    def _look_up(self, query: Query) -> tuple[Query, list[Verified]]:
        """The query that was asked last, and the candidates at the proposed places, or the reasons why there is none.

        If the robot is lost and no candidate is acceptable, landmarks that are not confirmed yet are used, too.
        """
        verified = self._retrieve(query)
        is_found = any(isinstance(each, Candidate) and self._acceptance.is_acceptable(each) for each in verified)
        if not is_found and not self.closures.is_localized(query.keyframe):
            submap = recent_submap_with_unconfirmed(self._map, query.keyframe, self._config.calibration)
            query, has_more = replace(query, submap=submap), len(submap) > len(query.submap)
            verified += self._retrieve(query) if has_more else []
        if not verified:
            reason = f"{len(query.submap)} landmarks in the submap, min_inliers is {MIN_INLIERS}"
            if len(query.submap) >= MIN_INLIERS:
                reason = "no matches that agree on a place"
            verified = [query.refusal(Stage.RETRIEVAL, reason)]
        return query, verified

    def _retrieve(self, query: Query) -> list[Verified]:
        """The candidates at the places that retrieval proposes."""
        if len(query.submap) < MIN_INLIERS:
            return []
        return [
            self._verifier.verify(query, place)
            if self._is_allowed(query, place)
            else query.refusal(Stage.RETRIEVAL, "outside the prior of the pose", place=place)
            for place in self._retriever.propose(query.submap, before_m=query.before_m)
        ]

    def _is_allowed(self, query: Query, place: Place) -> bool:
        """Whether a place is where the robot may be; in what it has mapped itself that is anywhere."""
        if self.initial_pose is None or place.segment != SEGMENT:
            return True
        first = next(each for each in self._keyframes if not each.is_prior)
        T_first_query = invert(first.odometry.T_odom_body) @ query.keyframe.odometry.T_odom_body
        return self.initial_pose.allows(place.T_local_query, T_first_query, query.keyframe.odometry.travel_m)

    def _accept_with_those_before(self, candidate: Candidate) -> list[LoopClosureRecord]:
        """Accept a retrieved closure, and those that it predicts for the keyframes before it and that are verified."""
        logger.info(
            "closed a loop: keyframe %d is at keyframe %d (score %.1f)",
            candidate.query.id,
            candidate.reference.id,
            candidate.score,
        )
        self._seed = seed = candidate
        records = [self.closures.add(candidate)]
        for query in reversed(self._recent):
            if query.keyframe.id in self.closures.closed:
                continue
            if (propagated := self._confirmed(self._predict(seed, query))) is not None:
                records.append(self.closures.add(propagated))
                seed = propagated
        return records
