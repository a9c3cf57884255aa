"""Outlier rejection at the end of a drive: which closures agree with the odometry and with one another."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import gtsam
import numpy as np

from slam.backend.factors import Edge, EdgeKind, Factor, PosePrior
from slam.backend.pose_graph.pose_graph_optimization import PoseGraphSolution, optimize_pose_graph
from slam.common.arrays import FloatArray
from slam.common.geometry import invert


def reject_outlier_closures(
    factors: Iterable[Factor],
    closures: Sequence[Edge],
    T_map_body: Mapping[int, FloatArray],
    T_local_body: Mapping[int, FloatArray],
    *,
    odometry_inflation: float,
) -> PoseGraphSolution:
    """Which closures agree with the odometry and with one another, by a robust optimisation of the pose graph.

    A step of the odometry over which the wheels slipped would contradict all true closures across it. The landmarks in
    view show it, and the square of their correction of a step is added to its covariance.

    No factor is removed here: that is left to the caller. Landmarks take no part: the problem is smaller, and merged
    landmarks would support the closures that merged them.

    Args:
        factors: all factors of the graph; of its closures only those in ``closures`` take part.
        closures: those that are tested.
        T_map_body: estimates (4, 4) by keyframe, the initial values.
        T_local_body: (4, 4) by keyframe, where odometry and landmarks in view put them.
        odometry_inflation: factor on the sigmas of the odometry, the same as in the odometry penalty.

    Raises:
        FactorGraphError: GTSAM cannot solve the graph.
    """
    others = list[PosePrior | Edge]()
    for factor in factors:
        match factor:
            case PosePrior():
                others.append(factor)
            case Edge() if factor.kind != EdgeKind.LOOP_CLOSURE:
                covariance = odometry_inflation**2 * factor.covariance
                if factor.kind == EdgeKind.ODOMETRY:
                    covariance = covariance + _squared_correction(factor, T_local_body)
                others.append(replace(factor, covariance=covariance))
    return optimize_pose_graph(T_map_body, others, closures)


def _squared_correction(step: Edge, T_local_body: Mapping[int, FloatArray]) -> FloatArray:
    """(6, 6): the outer product of the correction of a step by landmarks, rotation first, about the axes of its end."""
    T_from_to = invert(T_local_body[step.from_keyframe]) @ T_local_body[step.to_keyframe]
    correction = gtsam.Pose3.Logmap(gtsam.Pose3(invert(step.T_from_to) @ T_from_to))
    return np.outer(correction, correction)
