"""Acceptance of loop closures by their posterior probability.

Each candidate k is a pose in an earlier traversal, with the log-likelihood ratios of the landmarks around the robot
(same place against somewhere new; see :mod:`slam.loop_closure.likelihood_ratio`) and a prior
(:class:`slam.loop_closure.verification.PosePrior`). Its posterior odds against "somewhere new" are

    log o_k = log pi_k + sum_i LLR_ki,        p_k = o_k / (n_k + sum_k o_k),

where n_k is the likelihood ratio of "somewhere new" to clutter. A new place looks like clutter, where it is 1, or as
the map does from an arbitrary pose in its area A, whichever is likelier. The mean of exp(LLR) over those poses is the
sum over the other candidates r,

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
        log_odds = _posterior_log_odds(best, others)
        if log_odds >= self._least_log_odds:
            rivals = suppress_non_maxima([*others, *self._verifier.rivals(query, best)], self._sensor_range_m)
            log_odds = _posterior_log_odds(best, rivals)
        best = replace(best, posterior_log_odds=log_odds)
        if log_odds >= self._least_log_odds:
            return Decision(rejected, best)
        fits = best.log_likelihood_ratio >= self._least_log_odds
        reason = f"wrong with probability {expit(-log_odds):.2g}"
        return Decision((*rejected, best.record(Stage.CONSISTENCY if fits else Stage.ACCEPTANCE, reason)))


def _posterior_log_odds(candidate: Candidate, others: Sequence[Candidate]) -> float:
    """Log odds of a candidate against "somewhere new" and the other candidates of its query."""
    log_fits = [each.log_likelihood_ratio - each.unpredicted_penalty for each in others]
    log_new = max(np.logaddexp.reduce(log_fits), 0.0)
    return float(candidate.score - np.logaddexp.reduce([log_new, *(each.score for each in others)]))
