"""A loop-closure candidate: two keyframes, their relative pose, its log-likelihood ratio and its odometry penalty."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from logs.closures import Stage
from logs.messages import LoopClosureRecord
from logs.records import frozen
from slam.common.arrays import FloatArray, IntArray
from slam.common.geometry import invert, yaw_rad
from slam.object_map.submap import Submap
from slam.odometry.keyframe import Keyframe
from slam.place_recognition.place_search import Place

# Two candidates agree if they put the query this near to each other: a wrong pose is mostly shifted by the spacing of
# the objects in a row, or more. In sensor ranges.
AGREE_RANGES = 1.0 / 15.0
AGREE_RAD = np.deg2rad(5.0)


@frozen
class Candidate:
    """``T_reference_query`` (4, 4) between the bodies, covariance (6, 6) rotation first; ``T_local_query`` (4, 4) of
    the query's gravity frame in the local frame of the reference's traversal.

    ``log_likelihood_ratios`` (N,): LLR_i of the landmarks of the query, of which ``log_likelihood_ratio`` is the sum;
    ``pairs`` (K, 2): inliers, as confirmed landmarks of the query and of the reference.
    ``odometry_penalty`` is -log pi of the pose's prior, ``unpredicted_penalty`` the same if the odometry told nothing;
    see :class:`slam.loop_closure.verification.PosePrior`.
    ``place``: what proposed it.
    ``posterior_log_odds``: as in :class:`logs.messages.LoopClosureRecord`, None until they are computed.
    """

    query: Keyframe
    reference: Keyframe
    place: Place
    T_reference_query: FloatArray
    T_local_query: FloatArray
    covariance: FloatArray
    log_likelihood_ratios: FloatArray
    pairs: IntArray
    odometry_penalty: float
    unpredicted_penalty: float
    posterior_log_odds: float | None = None

    @property
    def crosses_break(self) -> bool:
        """Whether the odometry breaks between its keyframes."""
        return self.reference.odometry.segment != self.query.odometry.segment

    @property
    def log_likelihood_ratio(self) -> float:
        """Sum of the LLR_i of the landmarks, in nats."""
        return float(self.log_likelihood_ratios.sum())

    @property
    def score(self) -> float:
        """Log-likelihood ratio minus odometry penalty: the log posterior odds if there was no other candidate."""
        return self.log_likelihood_ratio - self.odometry_penalty

    def agrees(self, T_local_query: FloatArray, sensor_range_m: float) -> bool:
        """Whether another estimate (4, 4) of the pose differs by less than ``AGREE_RANGES`` and ``AGREE_RAD``."""
        T_between = invert(self.T_local_query) @ T_local_query
        apart_m = np.hypot(T_between[0, 3], T_between[1, 3])
        return bool(apart_m < AGREE_RANGES * sensor_range_m and abs(yaw_rad(T_between)) < AGREE_RAD)

    def record(self, stage: Stage, reason: str, *, inserted: bool = False) -> LoopClosureRecord:
        """The candidate with its decision, as a record of a log."""
        return replace(
            _record(self.query, stage, reason, self.reference, self.place),
            inlier_count=len(self.pairs),
            score=self.score,
            T_reference_query=self.T_reference_query,
            covariance=self.covariance,
            inserted=inserted,
            log_likelihood_ratio=self.log_likelihood_ratio,
            odometry_penalty=self.odometry_penalty,
            posterior_log_odds=self.posterior_log_odds,
            seed_query_keyframe_id=self.place.predicted_by,
        )


Verified = Candidate | LoopClosureRecord
"""A candidate, or the record with the reason why there is none at a place."""


@frozen
class Query:
    """A keyframe and the landmarks around it that its traversal found, in its gravity frame.

    ``before_m``: travel up to which landmarks and keyframes may be the reference of a loop closure.
    """

    keyframe: Keyframe
    submap: Submap
    T_local_gravity: FloatArray
    before_m: float

    @property
    def T_gravity_body(self) -> FloatArray:
        """The tilt (4, 4) of the keyframe, by the odometry."""
        return invert(self.T_local_gravity) @ self.keyframe.T_local_body

    def refusal(
        self, stage: Stage, reason: str, reference: Keyframe | None = None, *, place: Place | None = None
    ) -> LoopClosureRecord:
        """The record of a candidate that was rejected before it had a pose."""
        return _record(self.keyframe, stage, reason, reference, place)


def _record(
    query: Keyframe, stage: Stage, reason: str, reference: Keyframe | None, place: Place | None
) -> LoopClosureRecord:
    return LoopClosureRecord(
        stamp_ns=query.odometry.stamp_ns,
        query_keyframe_id=query.id,
        reference_keyframe_id=reference.id if reference else -1,
        accepted=stage == Stage.ACCEPTED,
        stage=stage.value,
        reason=reason,
        reference_stamp_ns=reference.odometry.stamp_ns if reference else 0,
        proposer=place.proposer if place else "",
    )


def suppress_non_maxima(candidates: Sequence[Candidate], sensor_range_m: float) -> list[Candidate]:
    """Of the candidates of one query that agree on its pose, the one with the highest score; by falling score."""
    kept: list[Candidate] = []
    for candidate in sorted(candidates, key=lambda c: -c.score):
        if not any(candidate.agrees(better.T_local_query, sensor_range_m) for better in kept):
            kept.append(candidate)
    return kept
