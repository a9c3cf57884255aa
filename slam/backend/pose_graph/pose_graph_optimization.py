"""A pose graph as GTSAM's factors, solved by the robust batch optimisation."""

from __future__ import annotations

from dataclasses import dataclass, replace

import gtsam
import numpy as np

from slam.backend.pose_graph.pose_graph import PoseGraph
from slam.backend.pose_graph.robust_optimization import MAX_ITERATIONS, RobustSolution, optimize_robustly
from slam.common.arrays import BoolArray
from slam.common.errors import FactorGraphError

FIXED_SIGMA = 1e-5
"""How firmly the first pose is held, in metres and radians; it is given back as it was."""


@dataclass(frozen=True, slots=True, eq=False)
class PoseGraphSolution:
    """The graph at its solution, and how it was found; weights are those of the closures."""

    graph: PoseGraph
    solution: RobustSolution


def optimize_pose_graph(
    graph: PoseGraph, is_closure: BoolArray, *, max_iterations: int = MAX_ITERATIONS
) -> PoseGraphSolution:
    """Solve a connected pose graph.

    Args:
        graph: with one pose at least.
        is_closure: (E,), the edges that may be false; the others connect all poses. All false: plain least squares.
        max_iterations: of one solution, of which there are several.

    Raises:
        FactorGraphError: GTSAM cannot solve it.
    """
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for (start, end), T, covariance in zip(graph.edges.tolist(), graph.T_from_to, graph.covariances, strict=True):
        noise = gtsam.noiseModel.Gaussian.Covariance(covariance)
        factors.add(gtsam.BetweenFactorPose3(start, end, gtsam.Pose3(T), noise))
    for vertex, T in enumerate(graph.T_world_vertex):
        values.insert(vertex, gtsam.Pose3(T))
    held = gtsam.noiseModel.Isotropic.Sigma(6, FIXED_SIGMA)
    factors.add(gtsam.PriorFactorPose3(0, gtsam.Pose3(graph.T_world_vertex[0]), held))
    try:
        solution = optimize_robustly(factors, values, np.flatnonzero(is_closure), max_iterations=max_iterations)
    except (RuntimeError, ValueError, IndexError) as error:
        first_line = next((line.strip() for line in str(error).splitlines() if line.strip()), type(error).__name__)
        raise FactorGraphError(f"the optimisation failed: {first_line}") from error
    poses = np.array([solution.values.atPose3(vertex).matrix() for vertex in range(len(graph.T_world_vertex))])
    if not np.isfinite(poses).all():
        raise FactorGraphError("the optimisation failed: a pose is not finite; check the measurements")
    poses[0] = graph.T_world_vertex[0]
    return PoseGraphSolution(replace(graph, T_world_vertex=poses), solution)
