"""From a place that a query may be to a candidate with all that speaks for and against it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from logs.messages import LoopClosureRecord
from slam.candidate import Candidate, Stage
from slam.config import Config
from slam.consistency import doubt_nats
from slam.evidence import weigh
from slam.factor_graph import FactorGraph
from slam.geometry import FloatArray, invert
from slam.keyframe_track import KeyframeTrack
from slam.mapper import Keyframe
from slam.matching import PASS_TRAVEL_M, Place, PlaceFinder
from slam.registration import Registration, refine
from slam.submap import Submap, gravity_frame

# A place this far from where the earlier pass drove is not one that it can tell much about.
MAX_REFERENCE_M = 20.0
NOWHERE = -1
# Two candidates are told apart beyond three standard deviations of the odometry between their references.
COMPATIBLE_NATS = 4.5


@dataclass(frozen=True, slots=True, eq=False)
class Query:
    """A keyframe and the landmarks around it, in its gravity frame."""

    keyframe: Keyframe
    submap: Submap
    T_odom_gravity: FloatArray

    @property
    def travel_m(self) -> float:
        """Travel up to the keyframe."""
        return self.keyframe.odometry.travel_m

    def refusal(self, stage: Stage, reason: str, reference: Keyframe | None = None) -> LoopClosureRecord:
        """The verdict on a candidate that never got a pose."""
        return LoopClosureRecord(
            stamp_ns=self.keyframe.odometry.stamp_ns,
            query_keyframe_id=self.keyframe.id,
            reference_keyframe_id=reference.id if reference else NOWHERE,
            accepted=False,
            stage=stage.value,
            reason=reason,
            retrieval_distance=float("inf"),
            reference_stamp_ns=reference.odometry.stamp_ns if reference else 0,
        )


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
        reference = self._nearest(T_odom_query, self._keyframes[leader.reference].odometry.travel_m, query)
        return Place(T_odom_query, reference.odometry.travel_m, 0.0) if reference else None

    def verify(self, query: Query, place: Place, *, leader: int = NOWHERE) -> Candidate | LoopClosureRecord:
        """The candidate for a place, or the verdict that it is none."""
        reference = self._nearest(place.T_odom_query, place.travel_m, query)
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
            return query.refusal(Stage.REGISTRATION, registration.reason, reference)
        reference = self._nearest(registration.T_reference_query, place.travel_m, query)
        if reference is None:
            return query.refusal(Stage.REGISTRATION, f"no earlier keyframe within {MAX_REFERENCE_M:g} m of the place")
        limits = self._config.loop_closure
        least = limits.min_objects if leader == NOWHERE else limits.supported_objects
        if len(registration.pairs) < least:
            reason = f"{len(registration.pairs)} objects meet, fewer than {least}"
            return query.refusal(Stage.REGISTRATION, reason, reference)
        return self._candidate(query, place, surroundings, registration, reference, leader)

    def can_both_hold(self, a: Candidate, b: Candidate) -> bool:
        """Whether two candidates of one query are the same place, which two passes saw and the odometry has apart."""
        first, second = sorted((a, b), key=lambda candidate: candidate.reference)
        T_implied = first.T_reference_query @ invert(second.T_reference_query)
        T_predicted = invert(self._graph.pose(first.reference)) @ self._graph.pose(second.reference)
        sigmas = self._track.drift_sigmas(first.reference, second.reference)
        return doubt_nats(T_predicted, T_implied, sigmas, self._config.loop_closure) < COMPATIBLE_NATS

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
        evidence = weigh(query.submap, surroundings, T_odom_gravity, registration.pairs, self._config.evidence)
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
        )

    def _covariance(self, registered: FloatArray) -> FloatArray:
        """That of the registration (6, 6) and the errors that all its inliers share."""
        limits = self._config.loop_closure
        tilt, yaw, shift = np.deg2rad(limits.tilt_sigma_deg), np.deg2rad(limits.base_sigma_deg), limits.base_sigma_m
        return np.asarray(registered + np.diag(np.array([tilt, tilt, yaw, shift, shift, shift]) ** 2))

    def _nearest(self, T_odom_query: FloatArray, travel_m: float, query: Query) -> Keyframe | None:
        """The keyframe of the pass around ``travel_m`` that came nearest to a place, if it came near."""
        found = self._track.nearest(
            T_odom_query[:3, 3],
            from_m=travel_m - PASS_TRAVEL_M,
            to_m=min(travel_m + PASS_TRAVEL_M, self.latest_m(query)),
        )
        return self._keyframes[found[0]] if found is not None and found[1] <= MAX_REFERENCE_M else None
