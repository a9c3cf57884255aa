"""What accepts loop closures: the interface of the rules for the candidates of a keyframe."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from logs.messages import LoopClosureRecord
from slam.loop_closure.candidate import Candidate, Query
from slam.place_recognition.place import Place


@dataclass(frozen=True, slots=True, eq=False)
class Decision:
    """``accepted``: the closure of a query, with the ``reason``, empty if it needed no support, and those of earlier
    keyframes that are ``supporting`` it; None if there is none. ``rejected``: records of the other candidates.
    ``contradicts_odometry``: whether the odometry alone kept a candidate from being accepted.
    """

    rejected: tuple[LoopClosureRecord, ...]
    accepted: Candidate | None = None
    reason: str = ""
    supporting: tuple[Candidate, ...] = ()
    contradicts_odometry: bool = False


class Acceptance(Protocol):
    """Rules that accept candidates; what they remember of earlier keyframes is their own."""

    min_objects: int
    """Objects without which no candidate is accepted."""

    def expected_places(self, query: Query) -> list[Place]:
        """Where hypotheses of earlier keyframes put a query."""

    def is_acceptable(self, candidate: Candidate) -> bool:
        """Whether a candidate would be accepted if there was no other."""

    def is_confirmed(self, propagated: Candidate) -> bool:
        """Whether a candidate at the pose that an accepted closure predicts is accepted."""

    def decide(self, query: Query, candidates: list[Candidate]) -> Decision:
        """Accept at most one of the candidates of a query, one at least, given by falling score."""

    def reset(self) -> None:
        """Forget all hypotheses."""
