"""Localization: a posterior over poses in earlier traversals, and "somewhere new".

Each hypothesis is a pose with the log-likelihood ratios of the landmarks around the robot (same place against somewhere
new; see :mod:`slam.loop_closure.likelihood_ratio`) and a prior (:mod:`slam.localization.pose_prior`). From keyframe to
keyframe its pose is propagated by the odometry, and it is measured again there. The posterior odds of hypothesis k
against "somewhere new" are

    log o_k = log pi_k + sum_i LLR_ki + min(0, sum_j LLR_kj),        p_k = o_k / (n_k + sum_k o_k),

where i are the landmarks of the submap, which all count at one pose, and j those that the robot has left behind, as
they were last measured at that hypothesis. They can only speak against it: each keyframe is registered anew, so what
fitted somewhat different poses before is no evidence for the pose of today.

n_k is the likelihood ratio of "somewhere new" to clutter. A new place looks like clutter, where it is 1, or as the map
does from an arbitrary pose in its area A, whichever is likelier. The mean of exp(LLR) over those poses is the sum over
the hypotheses r that cannot be true together with k,

    n_k = max(1, sum_r v_r exp(LLR_r)),

where v_r is the share, of all poses in A, of those that the registration r does not tell apart. By chance the mean is 1
at most, as it is over clutter. On a pattern that repeats it is more, the more often it repeats and the better it fits.

All decisions are reads of the posterior; this class changes nothing but itself.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from slam.common.arrays import BoolArray, FloatArray
from slam.common.config import LocalizationConfig
from slam.common.geometry import invert
from slam.loop_closure.candidate import Candidate, Query


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """A pose of the robot in the frame of a segment, by ``T_local_odom`` (4, 4) from the frame of its odometry.

    ``log_prior``: log pi_k; ``log_uniform``: the same where the robot can be anywhere; ``evidence``: LLR of each
    landmark in the submap; ``left_behind``: of those that were in it before; ``measured_m``: travel at which it was
    last measured.
    """

    T_local_odom: FloatArray
    segment: int
    log_prior: float
    log_uniform: float
    evidence: Mapping[int, float]
    left_behind: Mapping[int, float]
    measured_m: float

    @property
    def log_odds(self) -> float:
        """Log posterior odds against "somewhere new"."""
        return self.log_prior + self.log_likelihood_ratio

    @property
    def log_likelihood_ratio(self) -> float:
        """The evidence of the landmarks, in nats."""
        return sum(self.evidence.values()) + min(sum(self.left_behind.values()), 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Posterior:
    """``log_odds`` (K,) of the poses given against "somewhere new"; ``posterior_log_odds`` (K,) against that and all
    poses that cannot be true together with them; poses that can be share theirs.
    """

    log_odds: FloatArray
    posterior_log_odds: FloatArray

    @property
    def best(self) -> int:
        """Index of the likeliest pose."""
        return int(np.argmax(self.log_odds))


class Localizer:
    """The hypotheses of one robot."""

    def __init__(
        self,
        config: LocalizationConfig,
        which_agree: Callable[[FloatArray, FloatArray], BoolArray],
        are_consistent: Callable[[Candidate, Candidate], bool],
        *,
        memory_m: float,
    ) -> None:
        """``which_agree``: which estimates (..., 4, 4) of poses agree, pair by pair; ``are_consistent``: whether two
        candidates can be true together: a place that was passed twice; ``memory_m``: travel after which a hypothesis
        that is not measured any more is dropped.
        """
        self._config = config
        self._which_agree = which_agree
        self._are_consistent = are_consistent
        self._memory_m = memory_m
        self._hypotheses: list[Hypothesis] = []

    def reset(self) -> None:
        """Forget all hypotheses."""
        self._hypotheses = []

    def predictions(self, query: Query) -> list[tuple[int, FloatArray]]:
        """Segment and pose (4, 4) at a query of the likeliest hypotheses, for them to be measured there.

        Those with landmarks against them are left out: retrieval proposes them again if that changes.
        """
        supported = [each for each in self._hypotheses if each.log_likelihood_ratio > 0.0]
        likely = sorted(supported, key=lambda each: -each.log_odds)[: self._config.max_hypotheses]
        return [(each.segment, each.T_local_odom @ query.T_local_gravity) for each in likely]

    def update(self, query: Query, candidates: Sequence[Candidate]) -> Posterior:
        """Update the poses with the candidates of a query, at least one, of which no two agree; returns their
        posterior.
        """
        known = [each for each in self._hypotheses if query.travel_m - each.measured_m <= self._memory_m]
        agree = self._agreements(known, candidates, query.T_local_gravity)
        joined = [
            _joined(new, [known[k] for k in np.flatnonzero(same)], query)
            for new, same in zip(candidates, agree, strict=True)
        ]
        others = [known[k] for k in np.flatnonzero(~agree.any(axis=0))]
        self._hypotheses = joined + others
        log_odds = np.array([each.log_odds for each in joined])
        same = np.eye(len(joined), dtype=bool)
        for i in range(len(joined)):
            for j in range(i):
                same[i, j] = same[j, i] = self._are_consistent(candidates[i], candidates[j])
        together = np.logaddexp.reduce(np.where(same, log_odds, -np.inf), axis=1)
        others = np.logaddexp.reduce(np.where(same, -np.inf, log_odds), axis=1)
        log_fits = np.array([each.log_uniform + each.log_likelihood_ratio for each in joined])
        log_new = np.maximum(np.logaddexp.reduce(np.where(same, -np.inf, log_fits), axis=1), 0.0)
        return Posterior(log_odds, together - np.logaddexp(others, log_new))

    def _agreements(
        self, known: Sequence[Hypothesis], candidates: Sequence[Candidate], T_odom_query: FloatArray
    ) -> BoolArray:
        """Which hypotheses lead, by the odometry, to which of the candidates: (candidates, known)."""
        if not known:
            return np.zeros((len(candidates), 0), dtype=np.bool_)
        T_carried = np.array([each.T_local_odom for each in known]) @ T_odom_query
        segments = np.array([each.segment for each in known])
        return np.array(
            [
                (segments == new.reference.odometry.segment) & self._which_agree(T_carried, new.T_local_query)
                for new in candidates
            ]
        )


def _joined(candidate: Candidate, before: Sequence[Hypothesis], query: Query) -> Hypothesis:
    """The hypothesis at a candidate, with the evidence behind the robot of its predecessors in ``before``."""
    evidence = dict(zip(candidate.rows.tolist(), candidate.log_likelihood_ratios.tolist(), strict=True))
    earlier: dict[int, float] = {}
    for each in before:
        earlier |= {**each.left_behind, **each.evidence}
    return Hypothesis(
        candidate.T_local_query @ invert(query.T_local_gravity),
        candidate.reference.odometry.segment,
        -candidate.odometry_penalty,
        -candidate.unpredicted_penalty,
        evidence,
        {row: llr for row, llr in earlier.items() if row not in evidence},
        query.travel_m,
    )
