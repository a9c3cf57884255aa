"""Where the robot is: a posterior over poses in earlier traversals, and "somewhere new".

Each hypothesis is a pose with its log-likelihood ratio over the landmarks of the submap around the robot (same place
against somewhere new; see :mod:`slam.loop_closure.likelihood_ratio`) and a prior
(:mod:`slam.localization.pose_prior`). From keyframe to keyframe its pose is carried along by the odometry, and it is
measured again there. The posterior odds of hypothesis k against "somewhere new" are

    log o_k = log pi_k + LLR_k,        p_k = o_k / (1 + sum_j o_j).

Evidence adds up in the submap and nowhere else: its landmarks of the last stretch of travel all count at one pose. What
was measured at an earlier keyframe does not count beside it, because each keyframe is registered anew and the poses
may differ by more than the odometry can explain.

All decisions are reads of the posterior; this class changes nothing but itself.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from slam.common.arrays import FloatArray
from slam.common.config import LocalizationConfig
from slam.common.geometry import invert


@dataclass(frozen=True, slots=True, eq=False)
class PoseEvidence:
    """What one keyframe says of one pose: ``T_local_query`` (4, 4) of its gravity frame in the frame of a ``segment``.

    ``log_prior``: log pi_k; ``log_likelihood_ratio``: LLR_k.
    """

    T_local_query: FloatArray
    segment: int
    log_prior: float
    log_likelihood_ratio: float

    @property
    def log_odds(self) -> float:
        """Log posterior odds against "somewhere new"."""
        return self.log_prior + self.log_likelihood_ratio


@dataclass(frozen=True, slots=True, eq=False)
class Posterior:
    """``log_odds`` (K,) of the poses given against "somewhere new"; ``probabilities`` (K,), where poses that can be
    true together share theirs.
    """

    log_odds: FloatArray
    probabilities: FloatArray

    @property
    def best(self) -> int:
        """Index of the likeliest pose."""
        return int(np.argmax(self.log_odds))


class Localizer:
    """The hypotheses of one robot, all of one keyframe."""

    def __init__(self, config: LocalizationConfig, *, memory_m: float) -> None:
        """``memory_m``: travel after which hypotheses that are no longer measured are forgotten."""
        self._max_hypotheses = config.max_hypotheses
        self._memory_m = memory_m
        self._hypotheses: list[PoseEvidence] = []
        self._T_odom_query = np.eye(4)
        self._measured_m = -np.inf

    def reset(self) -> None:
        """Forget all hypotheses."""
        self._hypotheses = []

    def predictions(self, T_odom_query: FloatArray, travel_m: float) -> list[tuple[int, FloatArray]]:
        """Segment and pose (4, 4) of the likeliest hypotheses at a keyframe, for them to be measured there.

        ``T_odom_query`` (4, 4) is its gravity frame in the frame of the odometry, ``travel_m`` the travel up to it.
        """
        if travel_m - self._measured_m > self._memory_m:
            return []
        likely = sorted(self._hypotheses, key=lambda each: -each.log_odds)[: self._max_hypotheses]
        T_step = invert(self._T_odom_query) @ T_odom_query
        return [(each.segment, np.asarray(each.T_local_query @ T_step)) for each in likely]

    def update(
        self,
        T_odom_query: FloatArray,
        travel_m: float,
        measured: Sequence[PoseEvidence],
        are_consistent: Callable[[int, int], bool],
    ) -> Posterior:
        """Take in what a keyframe says of the poses, one at least, and return their posterior.

        Args:
            T_odom_query: (4, 4), gravity frame of the keyframe in the frame of the odometry.
            travel_m: travel up to it.
            measured: the poses; no two of them agree.
            are_consistent: whether two of them, by their indices, can be true together: a place that was passed twice.
        """
        self._hypotheses = list(measured)
        self._T_odom_query, self._measured_m = T_odom_query, travel_m
        log_odds = np.array([each.log_odds for each in measured])
        same = np.eye(len(measured), dtype=bool)
        for i in range(len(measured)):
            for j in range(i):
                same[i, j] = same[j, i] = are_consistent(i, j)
        total = float(logsumexp(np.append(log_odds, 0.0)))
        return Posterior(log_odds, np.exp(np.array([logsumexp(log_odds[row]) for row in same]) - total))


def log_odds_of(probability: float) -> float:
    """log(p / (1 - p))."""
    return float(np.log(probability) - np.log1p(-probability))
