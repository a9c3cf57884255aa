"""Loop closing: from a keyframe to accepted loop closures, with a record and a reason for every candidate.

``LoopCloser.close`` is where to begin reading.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from logs.messages import LoopClosureRecord
from slam.backend.factor_graph import FactorGraph
from slam.common.config import Config
from slam.common.geometry import invert
from slam.localization.continuity_monitor import ContinuityMonitor, recent_landmarks
from slam.loop_closure.acceptance import Acceptance
from slam.loop_closure.accepted_closures import AcceptedClosures
from slam.loop_closure.candidate import Candidate, Query, Stage
from slam.loop_closure.consistency import suppress_non_maxima
from slam.loop_closure.propagation import Predicted, Propagation
from slam.loop_closure.verification import Verifier
from slam.object_map.landmarks import ObjectMap
from slam.object_map.missing_landmarks import MissingLandmarks
from slam.object_map.submap import gravity_frame, recent_submap, recent_submap_with_unconfirmed
from slam.odometry.drift import KeyframeTrack
from slam.odometry.keyframe import Keyframe
from slam.place_recognition.imported_places import ImportedPlaces
from slam.place_recognition.initial_pose import InitialPose
from slam.place_recognition.place import Place
from slam.place_recognition.retrieval import PlaceRetriever
from slam.registration.parameters import MIN_INLIERS

logger = logging.getLogger(__name__)

CHANGED_SHARE = 0.2
"""A query is looked up if that share of its landmarks and those of the last one looked up are in one of them only."""


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
        self._calibration = config.calibration
        self._sensor_range_m = config.sensor_range_m
        self._propagation_distance_m = config.propagation_distance_m
        self._map = object_map
        self._keyframes = keyframes
        self._track = KeyframeTrack(config.calibration.odometry)
        for keyframe in keyframes:  # of the prior map
            self._track.add(keyframe)
        self._retriever = PlaceRetriever(config, object_map, imported)
        mapped = None if imported is None else imported.positions
        self._verifier = Verifier(config, self._retriever, self._track, graph, keyframes, mapped)
        self.closures = AcceptedClosures(config, object_map, graph, keyframes)
        self.missing = MissingLandmarks(object_map, keyframes, config.sensor_range_m)
        self._continuity = ContinuityMonitor(config.localization, self._sensor_range_m)
        # Only a prior map is trusted more than the robot's pose; a map in the making may itself be wrong.
        self._has_prior_map = any(keyframe.is_prior for keyframe in keyframes)
        self.initial_pose: InitialPose | None = None
        """Where in the prior map the robot is said to be; places elsewhere in it are left out."""
        self.lost_after_m: float | None = None
        """Travel after which the robot is inconsistent with the map, once it is lost; None while it is not."""
        self._looked_up: Query | None = None
        self._rejected_by_odometry: set[int] = set()
        self._acceptance = Acceptance(config, self._verifier)
        self._propagation = Propagation(config, self._verifier, self._acceptance, object_map)

    @property
    def rejected_by_odometry_count(self) -> int:
        """Keyframes with a candidate that would have been accepted with a uniform prior."""
        return sum(not self.closures.is_closed(each) for each in self._rejected_by_odometry)

    @property
    def kidnapping_probability(self) -> float:
        """Probability of a recent kidnapping, by the landmarks around."""
        return self._continuity.kidnapping_probability

    def close(self, keyframe: Keyframe) -> list[LoopClosureRecord]:
        """Look for loops at the newest keyframe; returns a record of every candidate, revised ones included."""
        self._track.add(keyframe)
        self._retriever.index_inactive_landmarks(keyframe.odometry)
        query = self._take_query(keyframe)
        seen = recent_landmarks(self._map, keyframe.odometry, self._continuity.memory_m)
        self.lost_after_m = self._continuity.update(keyframe, seen)
        if self.lost_after_m is not None:
            return [query.refusal(Stage.CONSISTENCY, "kidnapped: other landmarks are in view than a moment ago")]
        if self._verifier.latest_m(query) < self._keyframes[0].odometry.travel_m:
            return []
        # 1. Near an accepted closure the pose is predicted, and only verified.
        predicted = self._propagation.predict(query)
        if self._has_prior_map and self._propagation.is_contradicted(query, predicted):
            self.lost_after_m = query.travel_m - self._sensor_range_m
            return [query.refusal(Stage.CONSISTENCY, "expected landmarks not observed")]
        propagated = self._propagation.confirmed(predicted)
        if propagated is not None:
            return [self._accept(propagated, f"propagated from the closure of keyframe {propagated.seed_closure}")]
        alike = self._looked_up_alike(query)
        if alike is not None:
            return [query.refusal(Stage.REPEATED, f"landmarks are those of keyframe {alike.keyframe.id}")]
        self._looked_up = query
        # 2. Elsewhere landmarks that are still associated, or retrieval by descriptors, propose candidates.
        verified = self._verify_proposed(query) if self._has_enough_objects(query) else []
        # 3. If the robot is lost and none of them is acceptable, landmarks that are not confirmed yet are used, too.
        if not self.closures.is_localized(keyframe) and not self._any_acceptable(verified):
            confirmed, submap = query, recent_submap_with_unconfirmed(self._map, keyframe, self._calibration)
            query = replace(query, submap=submap)
            if self._has_enough_objects(query) and len(query.submap) > len(confirmed.submap):
                verified += self._verify_retrieved(query)
        if not verified:
            return [query.refusal(Stage.RETRIEVAL, self._why_nothing(query))]
        # 4. The candidate with the highest score is accepted or rejected.
        refused = [each for each in verified if isinstance(each, LoopClosureRecord)]
        candidates = suppress_non_maxima(
            [each for each in verified if isinstance(each, Candidate)], sensor_range_m=self._sensor_range_m
        )
        return refused + self._decide(query, candidates, predicted)

    def _looked_up_alike(self, query: Query) -> Query | None:
        """The last query that was looked up, if the answer is the same; a closure soon after predicts this one, too."""
        last = self._looked_up
        if last is None or not self._has_enough_objects(query) or not self.closures.is_localized(query.keyframe):
            return None
        common = len(np.intersect1d(query.submap.rows, last.submap.rows, assume_unique=True))
        all_of_both = len(query.submap) + len(last.submap) - common
        is_alike = common > (1.0 - CHANGED_SHARE) * all_of_both
        is_near = query.travel_m - last.travel_m < self._propagation_distance_m
        return last if is_alike and is_near else None

    def _verify_proposed(self, query: Query) -> list[Candidate | LoopClosureRecord]:
        """The candidates at the places that landmarks still followed and retrieval propose."""
        tracked = self._verifier.tracked_place(query)
        followed = [] if tracked is None else [self._verifier.verify(query, tracked)]
        return [*followed, *self._verify_retrieved(query)]

    def _verify_retrieved(self, query: Query) -> list[Candidate | LoopClosureRecord]:
        """The candidates at the places that retrieval proposes."""
        places = self._retriever.propose(query.submap, before_m=self._verifier.latest_m(query))
        return [
            self._verifier.verify(query, place)
            if self._is_plausible(query, place)
            else query.refusal(Stage.RETRIEVAL, "outside the prior of the pose", place=place)
            for place in places
        ]

    def _has_enough_objects(self, query: Query) -> bool:
        return len(query.submap) >= MIN_INLIERS

    def _why_nothing(self, query: Query) -> str:
        if self._has_enough_objects(query):
            return "no matches that agree on a place"
        return f"{len(query.submap)} landmarks in the submap, min_inliers is {MIN_INLIERS}"

    def _is_plausible(self, query: Query, place: Place) -> bool:
        """Whether a place is where the robot may be by what was said before."""
        prior = self.initial_pose
        if prior is None or place.segment != self._keyframes[0].odometry.segment or not self._has_prior_map:
            return True
        first = next(each for each in self._keyframes if not each.is_prior)
        T_first_query = invert(first.odometry.T_odom_body) @ query.keyframe.odometry.T_odom_body
        return prior.allows(place.T_local_query, T_first_query, query.travel_m)

    def _any_acceptable(self, verified: Sequence[Candidate | LoopClosureRecord]) -> bool:
        """Whether a candidate would be accepted if there was no other."""
        return any(isinstance(each, Candidate) and self._acceptance.is_acceptable(each) for each in verified)

    def declare_lost(self, keyframe: Keyframe, since: int) -> tuple[list[LoopClosureRecord], bool]:
        """Forget where the robot is, and revoke the closures from the keyframe ``since`` on.

        Returns the records of the revoked closures, and whether the robot was kidnapped; see
        :meth:`slam.loop_closure.accepted_closures.AcceptedClosures.revoke_since`.
        """
        revoked, is_kidnapped = self.closures.revoke_since(keyframe, since)
        self.lost_after_m = None
        self._looked_up = None
        self._continuity.restart()
        self._propagation.reset()
        return revoked, is_kidnapped

    def begin_segment(self, first: int) -> None:
        """Follow the keyframes from ``first`` on to a segment of their own."""
        self._track.replace_since(self._keyframes[first:])

    def _take_query(self, keyframe: Keyframe) -> Query:
        submap = recent_submap(self._map, keyframe, self._calibration)
        query = Query(keyframe, submap, gravity_frame(keyframe.T_local_body))
        self._propagation.remember(query)
        return query

    def _decide(
        self, query: Query, candidates: list[Candidate], predicted: Predicted | None
    ) -> list[LoopClosureRecord]:
        """Records of the candidates, given by falling score; ``predicted``: where the last closure leads."""
        if not candidates:
            return []
        decision = self._acceptance.decide(query, candidates)
        if decision.contradicts_odometry:
            self._rejected_by_odometry.add(query.keyframe.id)
        if decision.tracked is not None:
            self.closures.add_tracked(decision.tracked)
            self._looked_up = None  # it is no answer for the next keyframe, which may have let the landmarks go
        best, records = decision.accepted, list(decision.rejected)
        if best is None:
            return records
        if self._has_prior_map and self._propagation.is_elsewhere(predicted, best):
            self.lost_after_m = self._keyframes[query.keyframe.id - 1].odometry.travel_m
            return [*records, best.record(Stage.CONSISTENCY, "contradicts the odometry: kidnapped")]
        return [*records, *self._accept_and_propagate(best)]

    def _accept_and_propagate(self, candidate: Candidate) -> list[LoopClosureRecord]:
        """Accept a retrieved closure, and those that it predicts for the keyframes before it and that are verified."""
        logger.info(
            "closed a loop: keyframe %d is at keyframe %d (score %.1f)",
            candidate.query.id,
            candidate.reference.id,
            candidate.score,
        )
        records = [self._accept(candidate, "")]
        seed = candidate
        for query in self._propagation.queries_before(candidate.query.id):
            if self.closures.is_closed(query.keyframe.id):
                continue
            propagated = self._propagation.confirmed(self._propagation.predict_from(seed, query))
            if propagated is not None:
                records.append(self._accept(propagated, f"propagated from the closure of keyframe {seed.query.id}"))
                seed = propagated
        self._propagation.seed = candidate
        return records

    def _accept(self, candidate: Candidate, reason: str) -> LoopClosureRecord:
        """Accept a closure, which predicts the next ones."""
        self._propagation.seed = candidate
        if candidate.reference.is_prior:
            self.missing.add(candidate.query, candidate.T_local_query, candidate.pairs[:, 1])
        return self.closures.add(candidate, reason)
