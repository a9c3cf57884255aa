"""Acceptance of loop closures by their posterior probability."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial

from scipy.special import expit, logit

from logs.messages import LoopClosureRecord
from slam.common.config import Config
from slam.localization.pose_prior import failure_probability
from slam.loop_closure.candidate import Candidate, Query, Stage
from slam.loop_closure.consistency import suppress_non_maxima, which_agree
from slam.loop_closure.localizer import Localizer
from slam.loop_closure.verification import Verifier
from slam.place_recognition.place import Place

TRACKED = "its landmarks are still associated: there is no loop to close"


@dataclass(frozen=True, slots=True, eq=False)
class Decision:
    """``accepted``: the closure of a query, None if there is none. ``rejected``: records of the other candidates.
    ``tracked``: the candidate that is accepted without a closure, by landmarks that are still associated.
    ``contradicts_odometry``: whether a candidate would be accepted if the odometry predicted nothing.
    """

    rejected: tuple[LoopClosureRecord, ...]
    accepted: Candidate | None = None
    tracked: Candidate | None = None
    contradicts_odometry: bool = False


class Acceptance:
    """Accepts the candidate that is wrong with a probability below ``error_probability``.

    What it remembers of earlier keyframes are the hypotheses of its :class:`slam.loop_closure.localizer.Localizer`.
    """

    def __init__(self, config: Config, verifier: Verifier) -> None:
        self._failures_per_km = config.localization.failures_per_km
        self._least_log_odds = -float(logit(config.localization.error_probability))
        self._sensor_range_m = config.sensor_range_m
        self._verifier = verifier
        self._localizer = Localizer(
            config.localization,
            partial(which_agree, sensor_range_m=self._sensor_range_m),
            verifier.are_consistent,
            memory_m=config.propagation_distance_m,
        )

    def reset(self) -> None:
        """Forget all hypotheses."""
        self._localizer.reset()

    def expected_places(self, query: Query) -> list[Place]:
        """The hypotheses, propagated by the odometry."""
        places = (
            self._verifier.place_at(query, T_local_query, segment)
            for segment, T_local_query in self._localizer.predictions(query)
        )
        return [place for place in places if place is not None]

    def is_acceptable(self, candidate: Candidate) -> bool:
        """Whether a candidate would be accepted if there was no other."""
        return candidate.score >= self._least_log_odds

    def is_contradicted(self, log_likelihood_ratio: float, travel_m: float) -> bool:
        """Whether landmarks, seen on some travel first, make a predicted pose less likely than a failure of the
        odometry there.
        """
        return log_likelihood_ratio < math.log(failure_probability(self._failures_per_km, travel_m))

    def decide(self, query: Query, candidates: list[Candidate]) -> Decision:
        """The likeliest candidate is accepted if its posterior probability is high enough, rivals included.

        If it is the pose of landmarks that are still associated, the place is recognised and needs no closure.

        Rivals are the other candidates and, of a candidate that would be accepted, the poses at which a regular pattern
        of objects fits as well.
        """
        posterior = self._localizer.update(query, candidates)
        likeliest = candidates[posterior.best]
        others = [each for each in candidates if each is not likeliest]
        log_odds = float(posterior.posterior_log_odds[posterior.best])
        best = replace(likeliest, posterior_log_odds=log_odds)
        rejected = tuple(each.record(Stage.ACCEPTANCE, "another candidate is likelier") for each in others)
        if best.is_tracked and self._is_sure(log_odds):
            return Decision((*rejected, best.record(Stage.ASSOCIATION, TRACKED)), tracked=best)
        if self._is_sure(log_odds):
            rivals = self._verifier.rivals(query, best)
            compared = suppress_non_maxima([best, *others, *rivals], sensor_range_m=self._sensor_range_m)
            posterior = self._localizer.update(query, compared)
            is_best = self._agree(compared[posterior.best], best)
            best_rival = max((each.log_likelihood_ratio for each in compared if each is not best), default=None)
            itself = next(i for i, each in enumerate(compared) if self._agree(each, best))
            log_odds = float(posterior.posterior_log_odds[itself])
            best = replace(best, posterior_log_odds=log_odds, best_rival_llr=best_rival)
        else:
            is_best = True
        if is_best and self._is_sure(log_odds):
            return Decision(rejected, best)
        fits = best.log_likelihood_ratio >= self._least_log_odds
        likeliest_log_odds = log_odds if is_best else posterior.posterior_log_odds[posterior.best]
        doubt = f"wrong with probability {expit(-likeliest_log_odds):.2g}"
        reason = doubt if is_best else f"ambiguous: another pose is likelier, {doubt}"
        record = best.record(Stage.CONSISTENCY if fits else Stage.ACCEPTANCE, reason)
        unpredicted = best.log_likelihood_ratio - best.unpredicted_penalty
        return Decision(
            (*rejected, record), contradicts_odometry=is_best and unpredicted >= self._least_log_odds > best.score
        )

    def _is_sure(self, log_odds: float) -> bool:
        """Whether the accepted pose itself is; another may be surer that can be true together with two that cannot."""
        return log_odds >= self._least_log_odds

    def _agree(self, a: Candidate, b: Candidate) -> bool:
        return self._verifier.agree(a.T_local_query, b.T_local_query)
