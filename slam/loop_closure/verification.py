"""From a place that a query may be to a candidate with all that speaks for and against it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from logs.messages import LoopClosureRecord
from slam.backend.factor_graph import FactorGraph
from slam.common.arrays import FloatArray
from slam.common.config import Config
from slam.common.geometry import apply, invert
from slam.loop_closure.candidate import NOWHERE, Candidate, Query, Stage
from slam.loop_closure.consistency import agree, doubt_nats
from slam.loop_closure.likelihood_ratio import weigh
from slam.object_map.submap import PASS_TRAVEL_M, Submap, gravity_frame
from slam.odometry.drift import KeyframeTrack
from slam.odometry.keyframe import Keyframe
from slam.place_recognition.retrieval import Place, PlaceFinder
from slam.registration.registration import Registration, refine

# A place this far from where the earlier pass drove is not one that it can tell much about.
MAX_REFERENCE_M = 20.0
# Two candidates are told apart beyond three standard deviations of the odometry between their references.
COMPATIBLE_NATS = 4.5
# How far a query is slid along the street to see whether it fits there as well, and which of that is looked at closely.
SLIDES_M = np.concatenate([np.arange(-40.0, -3.0), np.arange(4.0, 41.0)])
SLIDE_REACH_M = 1.5
SLIDES_TRIED = 4


class Verifier:
    """Registers queries at places and weighs the result."""

    def __init__(
        self,
        config: Config,
        finder: PlaceFinder,
        track: KeyframeTrack,
        graph: FactorGraph,
        keyframes: Sequence[Keyframe],
    ) -> None:
        self._config = config
        self._finder = finder
        self._track = track
        self._graph = graph
        self._keyframes = keyframes

    def latest_m(self, query: Query) -> float:
        """Travel up to which the past is a place to return to."""
        return query.travel_m - self._config.loop_closure.min_travel_m

    def predict(self, leader: Candidate, query: Query) -> Place | None:
        """Where a closure puts another keyframe nearby: they are as far apart as the odometry says."""
        leading = self._keyframes[leader.query].odometry
        if leading.segment != query.keyframe.odometry.segment:
            return None
        T_leader_query = invert(gravity_frame(leading.T_odom_body)) @ query.T_odom_gravity
        T_odom_query = np.asarray(leader.T_odom_query @ T_leader_query)
        led_to = self._keyframes[leader.reference].odometry
        place = Place(T_odom_query, led_to.travel_m, led_to.segment, 0.0)
        reference = self._nearest(place, query)
        return replace(place, travel_m=reference.odometry.travel_m) if reference else None

    def verify(self, query: Query, place: Place, *, leader: int = NOWHERE) -> Candidate | LoopClosureRecord:
        """The candidate for a place, or the verdict that it is none."""
        reference = self._nearest(place, query)
        surroundings = self._finder.surroundings(place, before_m=self.latest_m(query))
        registration = refine(
            query.submap.positions,
            query.submap.labels,
            surroundings.positions,
            surroundings.labels,
            place.T_odom_query,
            self._config.registration,
            query_sigmas=query.submap.sigmas,
            reference_sigmas=surroundings.sigmas,
        )
        if registration.T_reference_query is None:
            return query.refusal(Stage.REGISTRATION, registration.reason, reference, rank=place.rank)
        reference = self._nearest(replace(place, T_odom_query=registration.T_reference_query), query)
        if reference is None:
            reason = f"no earlier keyframe within {MAX_REFERENCE_M:g} m of the place"
            return query.refusal(Stage.REGISTRATION, reason, rank=place.rank)
        limits = self._config.loop_closure
        least = limits.min_objects if leader == NOWHERE else limits.supported_objects
        if len(registration.pairs) < least:
            reason = f"{len(registration.pairs)} objects meet, fewer than {least}"
            return query.refusal(Stage.REGISTRATION, reason, reference, rank=place.rank)
        return self._candidate(query, place, surroundings, registration, reference, leader)

    def can_both_hold(self, a: Candidate, b: Candidate) -> bool:
        """Whether two candidates of one query are the same place, which two passes saw and the odometry has apart."""
        first, second = sorted((a, b), key=lambda candidate: candidate.reference)
        T_implied = first.T_reference_query @ invert(second.T_reference_query)
        T_predicted = invert(self._graph.pose(first.reference)) @ self._graph.pose(second.reference)
        sigmas = self._track.drift_sigmas(first.reference, second.reference)
        return doubt_nats(T_predicted, T_implied, sigmas, self._config.loop_closure) < COMPATIBLE_NATS

    def rival_along_the_street(self, query: Query, candidate: Candidate) -> float:
        """Most evidence [nats] of the query where it is slid along its heading: rows of objects repeat themselves.

        Where its objects meet others after a slide, it is registered and weighed there like anywhere.
        """
        pose = self._keyframes[candidate.reference].odometry
        place = Place(candidate.T_odom_query, pose.travel_m, pose.segment, 0.0)
        surroundings = self._finder.surroundings(place, before_m=self.latest_m(query))
        placed = apply(place.T_odom_query, query.submap.positions)
        offsets = surroundings.positions[:, None, :2] - placed[None, :, :2]  # (M, N, 2)
        same = surroundings.labels[:, None] == query.submap.labels
        heading = place.T_odom_query[:2, 0]
        shifts = offsets[None] - SLIDES_M[:, None, None, None] * heading  # (S, M, N, 2)
        near = same & (np.einsum("smni,smni->smn", shifts, shifts) < SLIDE_REACH_M**2)
        meeting = near.any(axis=1).sum(axis=1)
        rivals = [0.0]
        for slide in np.argsort(-meeting, kind="stable")[:SLIDES_TRIED]:
            T_slid = place.T_odom_query.copy()
            T_slid[:2, 3] += SLIDES_M[slide] * heading
            slid = self.verify(query, replace(place, T_odom_query=T_slid))
            if isinstance(slid, Candidate) and not agree(slid.T_odom_query, candidate.T_odom_query):
                rivals.append(slid.evidence_nats)
        return max(rivals)

    def _candidate(
        self,
        query: Query,
        place: Place,
        surroundings: Submap,
        registration: Registration,
        reference: Keyframe,
        leader: int,
    ) -> Candidate:
        T_odom_gravity, covariance = registration.T_reference_query, registration.covariance
        assert T_odom_gravity is not None
        assert covariance is not None
        crosses_break = reference.odometry.segment != query.keyframe.odometry.segment
        evidence = weigh(
            query.submap,
            surroundings,
            T_odom_gravity,
            registration.pairs,
            self._config.evidence,
            self._finder.class_shares() if crosses_break else None,
        )
        # The query's tilt is the odometry's; the registration is upright.
        T_gravity_body = invert(query.T_odom_gravity) @ query.keyframe.odometry.T_odom_body
        T_reference_query = invert(reference.odometry.T_odom_body) @ T_odom_gravity @ T_gravity_body
        T_predicted = invert(self._graph.pose(reference.id)) @ self._graph.pose(query.keyframe.id)
        sigmas = self._track.drift_sigmas(reference.id, query.keyframe.id)
        return Candidate(
            query=query.keyframe.id,
            reference=reference.id,
            query_stamp_ns=query.keyframe.odometry.stamp_ns,
            reference_stamp_ns=reference.odometry.stamp_ns,
            travel_m=query.travel_m,
            T_reference_query=T_reference_query,
            T_odom_query=T_odom_gravity,
            covariance=self._covariance(covariance),
            rows=query.submap.rows,
            nats=evidence.nats,
            pairs=np.column_stack(
                [query.submap.rows[registration.pairs[:, 0]], surroundings.rows[registration.pairs[:, 1]]]
            ),
            matched_fraction=evidence.matched_fraction,
            doubt_nats=doubt_nats(T_predicted, T_reference_query, sigmas, self._config.loop_closure),
            retrieval_distance=place.retrieval_distance,
            leader=leader,
            rank=place.rank,
        )

    def _covariance(self, registered: FloatArray) -> FloatArray:
        """That of the registration (6, 6) and the errors that all its inliers share."""
        limits = self._config.loop_closure
        tilt, yaw, shift = np.deg2rad(limits.tilt_sigma_deg), np.deg2rad(limits.base_sigma_deg), limits.base_sigma_m
        return np.asarray(registered + np.diag(np.array([tilt, tilt, yaw, shift, shift, shift]) ** 2))

    def _nearest(self, place: Place, query: Query) -> Keyframe | None:
        """The keyframe of the place's pass that came nearest to it, if it came near."""
        found = self._track.nearest(
            place.T_odom_query[:3, 3],
            segment=place.segment,
            from_m=place.travel_m - PASS_TRAVEL_M,
            to_m=min(place.travel_m + PASS_TRAVEL_M, self.latest_m(query)),
        )
        return self._keyframes[found[0]] if found is not None and found[1] <= MAX_REFERENCE_M else None
