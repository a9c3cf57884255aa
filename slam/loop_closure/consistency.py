"""Which closures agree with the odometry, and with one another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from slam.common.arrays import FloatArray
from slam.common.config import LoopClosureConfig
from slam.common.geometry import invert, yaw_rad
from slam.loop_closure.candidate import Candidate

# Two closures are one if they place the query this near to each other: a wrong place is mostly a shift by one object of
# a row or more.
AGREE_M = 2.0
AGREE_RAD = np.deg2rad(5.0)


def agree(T_a: FloatArray, T_b: FloatArray) -> bool:
    """Whether two estimates (4, 4) of one pose are one place."""
    T_between = invert(T_a) @ T_b
    return bool(np.hypot(T_between[0, 3], T_between[1, 3]) < AGREE_M and abs(float(yaw_rad(T_between))) < AGREE_RAD)


def distinct(candidates: Sequence[Candidate]) -> list[Candidate]:
    """The candidates of one query, best first, each place once; it has the best rank of those that came there."""
    kept: list[Candidate] = []
    for candidate in sorted(candidates, key=lambda c: -c.score_nats):
        same = (place for place, better in enumerate(kept) if agree(candidate.T_odom_query, better.T_odom_query))
        place = next(same, None)
        if place is None:
            kept.append(candidate)
        elif candidate.rank < kept[place].rank:
            kept[place] = replace(kept[place], rank=candidate.rank)
    return kept


def doubt_nats(
    T_predicted: FloatArray, T_measured: FloatArray, drift_sigmas: tuple[float, float], config: LoopClosureConfig
) -> float:
    """What the odometry says against a closure: half its squared Mahalanobis distance, up to the configured most.

    Bounded, because the odometry may have failed without notice, and then evidence must be able to outweigh it. Across
    a break the odometry says nothing, and any place of the map is possible: then a configured doubt is left.

    Args:
        T_predicted: ``T_reference_query`` (4, 4) as the trajectory has it now.
        T_measured: ``T_reference_query`` (4, 4) of the closure.
        drift_sigmas: of the odometry between the two: place [m] and heading [rad].
        config: the limits.
    """
    if np.isinf(drift_sigmas[0]):
        return config.break_doubt_nats
    sigma_m = config.odometry_inflation * np.hypot(drift_sigmas[0], config.base_sigma_m)
    sigma_rad = config.odometry_inflation * np.hypot(drift_sigmas[1], np.deg2rad(config.base_sigma_deg))
    off_m = float(np.hypot(*(T_measured[:2, 3] - T_predicted[:2, 3])))
    off_rad = abs(float(yaw_rad(invert(T_predicted) @ T_measured)))
    return min(0.5 * float((off_m / sigma_m) ** 2 + (off_rad / sigma_rad) ** 2), config.max_doubt_nats)


def joint_score_nats(candidates: Sequence[Candidate]) -> float:
    """Score of candidates (one at least) of different queries that agree: an object that several weigh counts once, by
    the mean of what they say; the greatest doubt counts.
    """
    _, places = np.unique(np.concatenate([each.rows for each in candidates]), return_inverse=True)
    sums = np.bincount(places, weights=np.concatenate([each.nats for each in candidates]))
    evidence = float(np.sum(sums / np.maximum(np.bincount(places), 1)))
    return evidence - max(each.doubt_nats for each in candidates)
