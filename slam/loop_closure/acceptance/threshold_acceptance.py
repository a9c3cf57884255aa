"""Acceptance by thresholds on the scores of candidates."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from slam.common.arrays import FloatArray
from slam.common.config import LoopClosureConfig
from slam.common.geometry import invert
from slam.loop_closure.acceptance.acceptance import Decision
from slam.loop_closure.candidate import Candidate, Query, Stage
from slam.loop_closure.consistency import accumulated_llr
from slam.loop_closure.verification import Verifier
from slam.object_map.submap import gravity_frame
from slam.odometry.keyframe import Keyframe
from slam.place_recognition.place import Place


class ThresholdAcceptance:
    """Accepts candidates whose score reaches ``accept_llr``, alone or with those of other keyframes."""

    def __init__(self, limits: LoopClosureConfig, verifier: Verifier, keyframes: Sequence[Keyframe]) -> None:
        self.min_objects = limits.min_inliers
        self._limits = limits
        self._verifier = verifier
        self._keyframes = keyframes
        self._hypotheses: deque[Candidate] = deque()

    def reset(self) -> None:
        """Forget all hypotheses."""
        self._hypotheses.clear()

    def expected_places(self, query: Query) -> list[Place]:
        """Where the latest hypothesis in an imported map is by the odometry; all others wait to be retrieved again.

        In so large a map a place that was found once may not be found again from the objects of the next stretch.
        """
        latest = self._hypotheses[-1] if self._hypotheses else None
        if latest is None or not self._keyframes[latest.reference].is_map_frame:
            return []
        place = self._verifier.predict(latest, query)
        return [] if place is None else [place]

    def is_acceptable(self, candidate: Candidate) -> bool:
        """Whether the score of a candidate reaches ``accept_llr``."""
        return candidate.score >= self._limits.accept_llr

    def is_confirmed(self, propagated: Candidate) -> bool:
        """Whether the LLR reaches ``accept_llr_tracked``."""
        return propagated.log_likelihood_ratio >= self._limits.accept_llr_tracked

    def decide(self, query: Query, candidates: list[Candidate]) -> Decision:
        """The candidate with the highest score is accepted, kept as a hypothesis or rejected."""
        best, others = candidates[0], candidates[1:]
        rejected = tuple(each.record(Stage.ACCEPTANCE, "another candidate has a higher score") for each in others)
        rivals = [each for each in others if not self._verifier.are_consistent(best, each)]
        rival_score = max((each.score for each in rivals), default=0.0)
        best = replace(best, best_rival_llr=max((each.log_likelihood_ratio for each in rivals), default=None))
        if best.score < self._limits.accept_llr:
            decision = self._accumulate(query, best)
            return replace(decision, rejected=rejected + decision.rejected)
        best, ambiguity = self._ambiguity(query, best, rival_score)
        if ambiguity:
            return Decision((*rejected, best.record(Stage.ACCEPTANCE, ambiguity)))
        return Decision(rejected, best)

    def _ambiguity(self, query: Query, candidate: Candidate, rival_score: float) -> tuple[Candidate, str]:
        """The candidate with the LLR of its best rival, and why it is ambiguous; empty if it is not."""
        if candidate.score - rival_score < self._limits.ambiguity_margin:
            return candidate, f"ambiguous: score {candidate.score:.1f}, second best {rival_score:.1f}"
        shifted = self._verifier.shifted(query, candidate)
        shifted_llr = max((each.log_likelihood_ratio for each in shifted), default=0.0)
        rival_llr = -np.inf if candidate.best_rival_llr is None else candidate.best_rival_llr
        compared = replace(candidate, best_rival_llr=max(rival_llr, shifted_llr, 0.0))
        if candidate.log_likelihood_ratio - max(shifted_llr, 0.0) < self._limits.ambiguity_margin:
            llr = candidate.log_likelihood_ratio
            return compared, f"ambiguous along track: LLR {llr:.1f}, shifted {max(shifted_llr, 0.0):.1f}"
        alias_score = max((each.score for each in self._verifier.aliases(query, candidate)), default=0.0)
        if candidate.score - max(alias_score, 0.0) < self._limits.ambiguity_margin:
            return compared, f"ambiguous pattern: score {candidate.score:.1f}, repeated {max(alias_score, 0.0):.1f}"
        return compared, ""

    def _accumulate(self, query: Query, candidate: Candidate) -> Decision:
        """A candidate below ``accept_llr`` is accepted together with earlier ones that agree."""
        self._forget(query)
        llr, limits = candidate.log_likelihood_ratio, self._limits
        values = f"LLR {llr:.1f}, odometry penalty {candidate.odometry_penalty:.1f}"
        if llr < limits.hypothesis_llr:
            reason = f"{values}: hypothesis_llr is {limits.hypothesis_llr:g}"
            return Decision((candidate.record(Stage.ACCEPTANCE, reason),))
        agreeing = [
            each
            for each in self._hypotheses
            if self._verifier.agree(self._carried(each, candidate), candidate.T_local_query)
        ]
        joint_score = accumulated_llr([*agreeing, candidate])
        candidate = replace(candidate, accumulated_llr=joint_score)
        if joint_score < limits.accept_llr:
            self._hypotheses.append(candidate)
            reason = f"{values}: accumulated score {joint_score:.1f}, accept_llr is {limits.accept_llr:g}"
            return Decision(
                (candidate.record(Stage.CONSISTENCY, reason),), contradicts_odometry=llr >= limits.accept_llr
            )
        candidate, ambiguity = self._ambiguity(query, candidate, -np.inf)
        if ambiguity:
            return Decision((candidate.record(Stage.ACCEPTANCE, ambiguity),))
        self._hypotheses = deque(each for each in self._hypotheses if each not in agreeing)
        reason = f"accumulated score {joint_score:.1f} with {len(agreeing)} other keyframes"
        return Decision((), candidate, reason, tuple(replace(each, accumulated_llr=joint_score) for each in agreeing))

    def _forget(self, query: Query) -> None:
        oldest_m = query.travel_m - self._limits.propagation_distance_m
        while self._hypotheses and self._hypotheses[0].travel_m < oldest_m:
            self._hypotheses.popleft()

    def _carried(self, earlier: Candidate, later: Candidate) -> FloatArray:
        """``T_local_query`` (4, 4) of a later candidate's query as an earlier candidate predicts it."""
        before = self._keyframes[earlier.query].T_local_body
        after = self._keyframes[later.query].T_local_body
        return earlier.T_local_query @ invert(gravity_frame(before)) @ gravity_frame(after)
