"""Verification: registers a query at a proposed place and computes the log-likelihood ratio and prior of the result."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from logs.closures import Stage
from logs.records import frozen
from slam.common.arrays import FloatArray, IntArray
from slam.common.config import Config
from slam.common.geometry import covariance_in_axes, fit_yaw_translation, gravity_frame, invert, yaw_rad
from slam.loop_closure.candidate import Candidate, Query, Verified
from slam.loop_closure.likelihood_ratio import compute_log_likelihood_ratios
from slam.object_map.submap import Submap
from slam.odometry.drift import KeyframeTrack
from slam.odometry.keyframe import Keyframe
from slam.odometry.noise import SLIP_INFLATION
from slam.place_recognition.place_search import Place
from slam.place_recognition.retrieval import PlaceRetriever
from slam.registration.registration import GATE_SIGMA, register, search_radius_m

TILT_SIGMA_RAD = np.deg2rad(1.0)
"""Error of gravity between two traversals."""
CLOSURE_SIGMA_RAD = np.deg2rad(0.8)
"""Heading error of a closure that its inliers share: what the centroids of a row of objects turn by."""
_PLANAR = (3, 4, 2)
"""x, y and yaw in a covariance (6, 6), rotation first."""


class Verifier:
    """Registers queries at proposed places and computes log-likelihood ratios; it remembers no query."""

    def __init__(
        self,
        config: Config,
        retriever: PlaceRetriever,
        keyframes: Sequence[Keyframe],
        pose: Callable[[int], FloatArray],
        observed_positions: Callable[[IntArray], FloatArray] | None = None,
        mapped: Sequence[FloatArray] = (),
    ) -> None:
        """``keyframes``: of the prior map, to which others are added; ``pose``: ``T_map_body`` (4, 4) of each, and
        ``observed_positions`` (N, 3) m of landmarks, both as the graph has them; ``mapped`` (N, 2) m each: objects of
        maps without keyframes, among which the robot may be anywhere.
        """
        self._config, objects = config, config.calibration.objects
        # Of the errors that all inliers of a registration share, rotation first.
        shift, height = objects.landmark_sigma_m, np.hypot(objects.landmark_sigma_m, objects.landmark_height_sigma_m)
        sigmas = np.array([TILT_SIGMA_RAD, TILT_SIGMA_RAD, CLOSURE_SIGMA_RAD, shift, shift, height])
        self._shared_covariance = np.diag(sigmas**2)
        self._sensor_range_m = config.sensor_range_m
        self._retriever = retriever
        self._pose = pose
        self._observed_positions = observed_positions
        self._keyframes = keyframes
        self.track = KeyframeTrack(config.calibration)
        for keyframe in keyframes:
            self.track.add(keyframe)
        # One number a cell is sooner than two, and no map has so many columns.
        self._mapped_cells = sum(
            len(np.unique(positions // config.sensor_range_m @ [1.0, 2.0**32])) for positions in mapped
        )
        self.reach_m = 2.0 * search_radius_m(config)
        """How far registration can move a pose: its search radius, which halves from step to step."""

    def predict(self, seed: Candidate, query: Query) -> Place | None:
        """The place that a closure predicts for another keyframe of its segment, by the odometry between the two."""
        if seed.query.odometry.segment != query.keyframe.odometry.segment:
            return None
        T_seed_query = invert(gravity_frame(seed.query.T_local_body)) @ query.T_local_gravity
        pose = seed.reference.odometry
        T_local_query = seed.T_local_query @ T_seed_query
        place = Place(T_local_query, pose.travel_m, pose.segment, "prediction", predicted_by=seed.query.id)
        reference = self._nearest(place, query)
        return replace(place, travel_m=reference.odometry.travel_m) if reference else None

    def verify(self, query: Query, place: Place) -> Verified:
        """The candidate at a place, or the record with the reason for its rejection."""
        submap = self._retriever.reference_submap(place, before_m=query.before_m)
        registration = register(query.submap, submap, place.T_local_query, self._config)
        T_local_query, covariance = registration.T_reference_query, registration.covariance
        if T_local_query is None or covariance is None:
            return query.refusal(Stage.REGISTRATION, registration.reason, self._nearest(place, query), place=place)
        reference = self._nearest(replace(place, T_local_query=T_local_query), query)
        if reference is None:
            reason = f"no earlier keyframe within {self._sensor_range_m:g} m of the place"
            return query.refusal(Stage.REGISTRATION, reason, place=place)
        ratios = self._ratios(query, submap, T_local_query, registration.pairs)
        prior = self._prior(query, place, reference)
        seen, met = query.submap.rows[registration.pairs[:, 0]], submap.rows[registration.pairs[:, 1]]
        exists = np.broadcast_to(query.submap.existence, len(query.submap))[registration.pairs[:, 0]] == 1.0
        # The query's tilt is the odometry's; the registration is upright.
        T_gravity_body = query.T_gravity_body
        T_local_body = T_local_query @ T_gravity_body
        in_body = covariance_in_axes(covariance + self._shared_covariance, T_gravity_body[:3, :3])
        return Candidate(
            query=query.keyframe,
            reference=reference,
            place=place,
            T_reference_query=self._T_reference_body(
                reference, T_local_body, submap.of(np.isin(submap.rows, met)), in_body
            ),
            T_local_query=T_local_query,
            covariance=in_body,
            log_likelihood_ratios=ratios,
            pairs=np.column_stack([seen, met])[exists],
            odometry_penalty=-prior.log_mass(T_local_query, covariance),
            unpredicted_penalty=-prior.log_uniform(covariance),
        )

    def _T_reference_body(
        self, reference: Keyframe, T_local_body: FloatArray, matched: Submap, covariance: FloatArray
    ) -> FloatArray:
        """The pose (4, 4) in a reference keyframe of a body that is at ``T_local_body`` (4, 4) among landmarks.

        The keyframe and the landmarks are where they were in the local map when they were seen last. Landmarks that the
        robot recognised after a while have moved others since, but no keyframes. Where the observations in the graph
        contradict the local map by more than ``GATE_SIGMA`` standard deviations in heading, x and y, they tell where
        the landmarks are from the keyframe.
        """
        T_reference_body: FloatArray = invert(reference.T_local_body) @ T_local_body
        if reference.is_prior or self._observed_positions is None:
            return T_reference_body
        observed = self._observed_positions(matched.rows)
        if not np.isfinite(observed).all():
            return T_reference_body
        T_map_local = fit_yaw_translation(matched.positions, observed)
        T_observed: FloatArray = invert(self._pose(reference.id)) @ T_map_local @ T_local_body
        T_between = invert(T_reference_body) @ T_observed
        apart = np.array([yaw_rad(T_between), *T_between[:2, 3]])
        is_moved = apart @ np.linalg.solve(covariance[2:5, 2:5], apart) > GATE_SIGMA**2
        return T_observed if is_moved else T_reference_body

    def unmatched(self, query: Query, place: Place) -> FloatArray:
        """LLR (N,) of each object of the query at a place where it cannot be registered: none has a match."""
        submap = self._retriever.reference_submap(place, before_m=query.before_m)
        return self._ratios(query, submap, place.T_local_query, np.zeros((0, 2), dtype=np.int64))

    def rivals(self, query: Query, candidate: Candidate) -> list[Candidate]:
        """Candidates at other poses where objects in rows, or in another repeated pattern, would fit as well."""
        reference = candidate.reference.odometry
        repeated = candidate.T_local_query @ self._retriever.self_similar_poses(query.submap)
        found = [
            self.verify(query, Place(T, reference.travel_m, reference.segment, candidate.place.proposer))
            for T in repeated
        ]
        return [
            each
            for each in found
            if isinstance(each, Candidate) and not each.agrees(candidate.T_local_query, self._sensor_range_m)
        ]

    def _prior(self, query: Query, place: Place, reference: Keyframe) -> "PosePrior":
        """The prior of the query's pose: by the odometry since the closure that predicts it, or since the reference."""
        T_local_query, since = place.T_local_query, place.predicted_by
        if since is None:
            since = reference.id
            T_predicted = invert(self._pose(since)) @ self._pose(query.keyframe.id)
            T_local_query = gravity_frame(reference.T_local_body @ T_predicted @ invert(query.T_gravity_body))
        drift_m, drift_rad = self.track.drift_sigmas(*sorted((since, query.keyframe.id)))
        travel_m = abs(query.keyframe.odometry.travel_m - self._keyframes[since].odometry.travel_m)
        return PosePrior(
            T_local_query,
            np.hypot(SLIP_INFLATION * drift_m, self._config.calibration.objects.landmark_sigma_m),
            np.hypot(SLIP_INFLATION * drift_rad, CLOSURE_SIGMA_RAD),
            self._config.localization.failure_probability(travel_m),
            (len(self.track.cells) + self._mapped_cells) * self._sensor_range_m**2,
        )

    def _ratios(self, query: Query, submap: Submap, T_local_query: FloatArray, pairs: IntArray) -> FloatArray:
        shares = self._retriever.class_shares()
        return compute_log_likelihood_ratios(query.submap, submap, T_local_query, pairs, self._sensor_range_m, shares)

    def _nearest(self, place: Place, query: Query) -> Keyframe | None:
        """The nearest keyframe of the reference traversal within the sensor range.

        Farther away, the map of that traversal has less than half of what is in view.
        """
        extent_m = self._config.traversal_extent_m
        found = self.track.nearest(
            place.T_local_query[:3, 3],
            segment=place.segment,
            from_m=place.travel_m - extent_m,
            to_m=min(place.travel_m + extent_m, query.before_m),
        )
        if found is None:
            return None
        reference = self._keyframes[found[0]]
        return reference if reference.is_map_frame or found[1] <= self._sensor_range_m else None


@frozen
class PosePrior:
    """p(T) = (1 - f) N(T; T_predicted, S) + f / (2 pi A), over x, y and heading.

    ``T_local_query`` (4, 4) is the predicted pose; ``sigma_m`` and ``sigma_rad`` are the standard deviations of each
    coordinate and of the heading, infinite where the odometry predicts nothing; ``failure_probability`` is f, in
    (0, 1), and ``area_m2`` is A, the area in which the robot can be.
    """

    T_local_query: FloatArray
    sigma_m: float
    sigma_rad: float
    failure_probability: float
    area_m2: float

    def log_mass(self, T_local_query: FloatArray, covariance: FloatArray) -> float:
        """Logarithm of the prior probability of the poses that a measurement does not tell apart.

        It is the integral of p(T) exp(-d^2 / 2) over x, y and heading, where d is the Mahalanobis distance of T from
        the measured pose ``T_local_query`` (4, 4) with its ``covariance`` (6, 6), rotation first (Laplace's
        approximation of the evidence: MacKay, Information Theory, Inference, and Learning Algorithms, chapter 28).
        """
        log_uniform = self.log_uniform(covariance)
        if np.isinf(self.sigma_m):
            return min(log_uniform, 0.0)
        planar = covariance[np.ix_(_PLANAR, _PLANAR)]
        T_residual = invert(self.T_local_query) @ T_local_query
        residual = np.array([T_residual[0, 3], T_residual[1, 3], yaw_rad(T_residual)])
        spread = planar + np.diag([self.sigma_m**2, self.sigma_m**2, self.sigma_rad**2])
        log_normal = -0.5 * float(
            residual @ np.linalg.solve(spread, residual) + np.linalg.slogdet(2.0 * np.pi * spread)[1]
        )
        followed = np.log1p(-self.failure_probability) + log_normal + _log_volume(covariance)
        return min(float(np.logaddexp(followed, np.log(self.failure_probability) + log_uniform)), 0.0)

    def log_uniform(self, covariance: FloatArray) -> float:
        """The same where the robot can be anywhere in the area."""
        return float(_log_volume(covariance) - np.log(2.0 * np.pi * self.area_m2))


def _log_volume(covariance: FloatArray) -> float:
    """Logarithm of the integral of exp(-d^2 / 2) over x, y and heading [log m^2 rad]."""
    return 0.5 * float(np.linalg.slogdet(2.0 * np.pi * covariance[np.ix_(_PLANAR, _PLANAR)])[1])
