"""Which closures of a finished drive agree with the odometry and with one another."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X

from slam.backend.factors import Anchor, Edge, Factor, between_factor, prior_factor
from slam.backend.robust_optimization import optimize_robustly
from slam.common.arrays import FloatArray, IntArray
from slam.common.errors import FactorGraphError


@dataclass(frozen=True, slots=True)
class Judgement:
    """For the number of each closure its final weight in [0, 1] and whether it is to be kept; ``message`` says what
    went wrong, if anything.
    """

    weights: dict[int, float]
    kept: dict[int, bool]
    message: str


def judge_closures(
    factors: Mapping[int, Factor],
    closures: Sequence[int],
    keyframes: IntArray,
    T_map_body: FloatArray,
    *,
    odometry_inflation: float,
) -> Judgement:
    """Decide on the keyframes alone, robustly and from scratch.

    Without the landmarks, because there are few keyframes, and because merged landmarks would speak for the very
    closures that merged them.

    Args:
        factors: all factors of the graph by their numbers.
        closures: numbers of those that are judged; other closures have no say.
        keyframes: ids (K,).
        T_map_body: (K, 4, 4), their estimates.
        odometry_inflation: factor on the sigmas of the odometry, which may drift more than it was said to; when a
            candidate is accepted the odometry is asked with the same one.

    Raises:
        FactorGraphError: the keyframes do not hang together without closures.
    """
    graph, at = gtsam.NonlinearFactorGraph(), dict[int, int]()
    judged = set(closures)
    for number, factor in factors.items():
        match factor:
            case Anchor():
                graph.add(prior_factor(factor))
            case Edge() if factor.kind != "closure":
                graph.add(between_factor(replace(factor, covariance=odometry_inflation**2 * factor.covariance)))
            case Edge() if number in judged:
                at[number] = graph.size()
                graph.add(between_factor(replace(factor, kind="odometry")))
    values = gtsam.Values()
    for keyframe, T in zip(keyframes.tolist(), T_map_body, strict=True):
        values.insert(X(keyframe), gtsam.Pose3(T))
    try:
        solution = optimize_robustly(graph, values, np.array(list(at.values()), dtype=np.int64))
    except RuntimeError as error:
        raise FactorGraphError(f"the closures could not be judged: {error}") from error
    return Judgement(
        dict(zip(at, solution.weights.tolist(), strict=True)),
        dict(zip(at, solution.kept.tolist(), strict=True)),
        solution.message,
    )
