"""Acceptance of loop closures by their posterior probability.

Each candidate k is a pose in an earlier traversal, with the log-likelihood ratios of the landmarks around the robot
(same place against somewhere new; see :mod:`slam.loop_closure.likelihood_ratio`) and a prior
(:class:`slam.loop_closure.verification.PosePrior`). Its posterior odds against "somewhere new" are

    log o_k = log pi_k + sum_i LLR_ki,        p_k = o_k / (n_k + sum_k o_k),

where n_k is the likelihood ratio of "somewhere new" to clutter. A new place looks like clutter, where it is 1, or as
the map does from an arbitrary pose in its area A, whichever is likelier. The mean of exp(LLR) over those poses is the
sum over the candidates r that cannot be true together with k,

    n_k = max(1, sum_r v_r exp(LLR_r)),

where v_r is the share, of all poses in A, of those that the registration r does not tell apart. By chance the mean is
1 at most, as it is over clutter. On a pattern that repeats it is more, the more often it repeats and the better it
fits.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import expit, logit

from logs.closures import Stage
from logs.messages import LoopClosureRecord
from logs.records import frozen
from slam.common.arrays import FloatArray
from slam.common.config import Config
from slam.loop_closure.candidate import Candidate, Query, Verified, suppress_non_maxima
from slam.loop_closure.verification import Verifier


@frozen
class Decision:
    """``accepted``: the closure of a query, None if there is none. ``rejected``: records of the other candidates, the
    likeliest one last.
    """

    rejected: tuple[LoopClosureRecord, ...]
    accepted: Candidate | None = None


class Acceptance:
    """Accepts the candidate that is wrong with a probability below ``error_probability``."""

    def __init__(self, config: Config, verifier: Verifier) -> None:
        self._least_log_odds = -float(logit(config.localization.error_probability))
        self._sensor_range_m = config.sensor_range_m
        self._verifier = verifier

    def is_acceptable(self, candidate: Candidate) -> bool:
        """Whether a candidate would be accepted if there was no other."""
        return candidate.score >= self._least_log_odds

    def decide(self, query: Query, verified: Sequence[Verified]) -> Decision:
        """The likeliest candidate is accepted if its posterior probability is high enough, rivals included.

        Rivals are the other candidates and, of a candidate that would be accepted, the poses at which a regular pattern
        of objects fits as well.

        Args:
            query: of the candidates.
            verified: its candidates, or the reasons why there is none at a place.
        """
        refused = tuple(each for each in verified if isinstance(each, LoopClosureRecord))
        candidates = suppress_non_maxima(
            [each for each in verified if isinstance(each, Candidate)], self._sensor_range_m
        )
        if not candidates:
            return Decision(refused)
        best, *others = candidates
        rejected = (*refused, *(each.record(Stage.ACCEPTANCE, "another candidate is likelier") for each in others))
        log_odds, doubt = self._posterior_log_odds(candidates)[0], ""
        if log_odds >= self._least_log_odds:
            rivals = suppress_non_maxima([*others, *self._verifier.rivals(query, best)], self._sensor_range_m)
            log_odds = self._posterior_log_odds([best, *rivals])[0]
            # It may be surer, where it can be true together with two that cannot.
            doubt = "ambiguous: another pose is likelier, " if rivals and rivals[0].score > best.score else ""
        best = replace(best, posterior_log_odds=log_odds)
        if log_odds >= self._least_log_odds and not doubt:
            return Decision(rejected, best)
        fits = best.log_likelihood_ratio >= self._least_log_odds
        reason = f"{doubt}wrong with probability {expit(-log_odds):.2g}"
        return Decision((*rejected, best.record(Stage.CONSISTENCY if fits else Stage.ACCEPTANCE, reason)))

    def _posterior_log_odds(self, candidates: Sequence[Candidate]) -> FloatArray:
        """Log odds (K,) of each candidate against "somewhere new" and all that cannot be true together with it; those
        that can share theirs.
        """
        are_together = np.eye(len(candidates), dtype=np.bool_)
        for i, a in enumerate(candidates):
            for j, b in enumerate(candidates[:i]):
                are_together[i, j] = are_together[j, i] = self._verifier.are_consistent(a, b)
        log_odds = np.array([each.score for each in candidates])
        log_fits = np.array([each.log_likelihood_ratio - each.unpredicted_penalty for each in candidates])
        together = np.logaddexp.reduce(np.where(are_together, log_odds, -np.inf), axis=1)
        others = np.logaddexp.reduce(np.where(are_together, -np.inf, log_odds), axis=1)
        log_new = np.maximum(np.logaddexp.reduce(np.where(are_together, -np.inf, log_fits), axis=1), 0.0)
        return np.asarray(together - np.logaddexp(others, log_new))
