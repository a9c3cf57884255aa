"""Outlier rejection at the end of a drive: which closures agree with the odometry and with one another."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X

from slam.backend.batch_solver import MIN_DECREASE
from slam.backend.factors import Edge, EdgeKind, Factor, PosePrior, between_factor, prior_factor
from slam.backend.pose_graph.robust_optimization import optimize_robustly
from slam.common.arrays import FloatArray, IntArray
from slam.common.errors import FactorGraphError
from slam.common.geometry import invert


@dataclass(frozen=True, slots=True)
class OutlierRejection:
    """For the number of each closure its final kernel weight in [0, 1] and whether it is kept; ``message``: a warning
    or empty.
    """

    weights: dict[int, float]
    kept: dict[int, bool]
    message: str


def reject_outlier_closures(
    factors: Mapping[int, Factor],
    closures: Sequence[int],
    keyframes: IntArray,
    T_map_body: FloatArray,
    T_local_body: FloatArray,
    *,
    odometry_inflation: float,
) -> OutlierRejection:
    """Rejection of closures that contradict the odometry or one another, by a robust optimisation of the pose graph.

    A step of the odometry over which the wheels slipped would contradict all true closures across it. The landmarks in
    view show it, and the square of their correction of a step is added to its covariance.

    The tested closures are put to :func:`slam.backend.pose_graph.robust_optimization.optimize_robustly`, which begins
    at the solution without them. No factor is removed here: that is left to the caller. Landmarks take no part: the
    problem is smaller, and merged landmarks would support the closures that merged them.

    Args:
        factors: all factors of the graph by their numbers.
        closures: numbers of those that are tested; closures that are not among them take no part.
        keyframes: ids (K,).
        T_map_body: (K, 4, 4), their estimates, the initial values.
        T_local_body: (K, 4, 4), where odometry and landmarks in view put them.
        odometry_inflation: factor on the sigmas of the odometry, the same as in the odometry penalty.

    Returns:
        For each tested closure its weight and whether it is kept, and a warning where they were hard to tell apart.

    Raises:
        FactorGraphError: GTSAM cannot solve the graph, for example because only a closure holds a keyframe.
    """
    graph, at = gtsam.NonlinearFactorGraph(), dict[int, int]()
    tested, local = set(closures), dict(zip(keyframes.tolist(), T_local_body, strict=True))
    for number, factor in factors.items():
        match factor:
            case PosePrior():
                graph.add(prior_factor(factor))
            case Edge() if factor.kind != EdgeKind.LOOP_CLOSURE:
                covariance = odometry_inflation**2 * factor.covariance
                if factor.kind == EdgeKind.ODOMETRY:
                    covariance = covariance + _squared_correction(factor, local)
                graph.add(between_factor(replace(factor, covariance=covariance)))
            case Edge() if number in tested:
                at[number] = graph.size()
                graph.add(between_factor(replace(factor, kind=EdgeKind.ODOMETRY)))
    values = gtsam.Values()
    for keyframe, T in zip(keyframes.tolist(), T_map_body, strict=True):
        values.insert(X(keyframe), gtsam.Pose3(T))
    try:
        tested_at = np.array(list(at.values()), dtype=np.int64)
        solution = optimize_robustly(graph, values, tested_at, min_decrease=MIN_DECREASE)
    except RuntimeError as error:
        raise FactorGraphError(f"the closures could not be tested: {error}") from error
    return OutlierRejection(
        dict(zip(at, solution.weights.tolist(), strict=True)),
        dict(zip(at, solution.kept.tolist(), strict=True)),
        solution.message,
    )


def _squared_correction(step: Edge, T_local_body: Mapping[int, FloatArray]) -> FloatArray:
    """(6, 6): the outer product of the correction of a step by landmarks, rotation first, about the axes of its end."""
    T_from_to = invert(T_local_body[step.from_keyframe]) @ T_local_body[step.to_keyframe]
    correction = gtsam.Pose3.Logmap(gtsam.Pose3(invert(step.T_from_to) @ T_from_to))
    return np.outer(correction, correction)
