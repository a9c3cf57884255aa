"""A loop-closure candidate: two keyframes, where one is seen from the other, and all that speaks for and against it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from logs.messages import LoopClosureRecord
from slam.backend.factors import Edge
from slam.common.arrays import FloatArray, IntArray
from slam.object_map.submap import Submap
from slam.odometry.keyframe import Keyframe

NOWHERE = -1


class Stage(StrEnum):
    """Where the verdict on a candidate fell."""

    RETRIEVAL = "retrieval"
    REGISTRATION = "registration"
    ACCEPTANCE = "acceptance"
    CONSISTENCY = "consistency"
    BACK_END = "back_end"
    ACCEPTED = "accepted"


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """``T_reference_query`` (4, 4) between the bodies, covariance (6, 6) rotation first; ``T_odom_query`` (4, 4) of the
    query's gravity frame as the reference's pass saw the odometry frame.

    ``rows`` (N,) and ``nats`` (N,): what each landmark of the query says; ``pairs`` (K, 2): landmarks of the query and
    of the reference that meet. ``evidence_nats`` is their sum, ``doubt_nats`` what the odometry says against it.
    ``leader``: the keyframe whose closure predicted this one, -1 if descriptors found it; ``rank``: as in
    :class:`slam.place_recognition.retrieval.Place`.
    """

    query: int
    reference: int
    query_stamp_ns: int
    reference_stamp_ns: int
    travel_m: float
    T_reference_query: FloatArray
    T_odom_query: FloatArray
    covariance: FloatArray
    rows: IntArray
    nats: FloatArray
    pairs: IntArray
    matched_fraction: float
    doubt_nats: float
    retrieval_distance: float
    leader: int = -1
    rank: int = 0

    @property
    def evidence_nats(self) -> float:
        """What the objects say, summed up."""
        return float(self.nats.sum())

    @property
    def score_nats(self) -> float:
        """Evidence less doubt: by this a candidate is judged."""
        return self.evidence_nats - self.doubt_nats

    def edge(self) -> Edge:
        """The between-factor of this closure."""
        return Edge(self.reference, self.query, self.T_reference_query, self.covariance, "closure")

    def record(self, stage: Stage, reason: str, *, inserted: bool = False) -> LoopClosureRecord:
        """The candidate with its verdict, as it goes into a log."""
        return LoopClosureRecord(
            stamp_ns=self.query_stamp_ns,
            query_keyframe_id=self.query,
            reference_keyframe_id=self.reference,
            accepted=stage == Stage.ACCEPTED,
            stage=stage.value,
            reason=reason,
            retrieval_distance=self.retrieval_distance,
            inlier_count=len(self.pairs),
            inlier_fraction=self.matched_fraction,
            score=self.score_nats,
            T_reference_query=self.T_reference_query,
            covariance=self.covariance,
            reference_stamp_ns=self.reference_stamp_ns,
            inserted=inserted,
            rank=self.rank,
        )


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

    def refusal(
        self, stage: Stage, reason: str, reference: Keyframe | None = None, *, rank: int = 0
    ) -> LoopClosureRecord:
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
            rank=rank,
        )
