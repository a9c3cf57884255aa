"""A pose graph as GTSAM's factors, solved by the robust batch optimisation."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import gtsam
import numpy as np

from slam.backend.pose_graph.pose_graph import PoseGraph
from slam.backend.pose_graph.robust_optimization import MAX_ITERATIONS, RobustSolution, optimize_robustly
from slam.common.arrays import BoolArray, FloatArray
from slam.common.errors import FactorGraphError

FIXED_SIGMA = 1e-5
"""How firmly a fixed vertex is held, in metres and radians; its pose is given back as it was."""


@dataclass(frozen=True, slots=True, eq=False)
class PoseGraphSolution:
    """The graph at its solution, which edges (E,) are closures, and how it was found; weights are the closures'."""

    graph: PoseGraph
    is_closure: BoolArray
    solution: RobustSolution


def optimize_pose_graph(
    graph: PoseGraph, is_closure: BoolArray, *, max_iterations: int = MAX_ITERATIONS
) -> PoseGraphSolution:
    """Solve a connected pose graph; without a fixed vertex that of the least id is held.

    Args:
        graph: as :func:`slam.backend.pose_graph.pose_graph.make_pose_graph` makes it.
        is_closure: (E,), the edges that may be false; the others connect all vertices. All false: plain least squares.
        max_iterations: of one solution, of which there are several.

    Raises:
        FactorGraphError: GTSAM cannot solve it.
    """
    held = graph.fixed_ids if len(graph.fixed_ids) else graph.vertex_ids[[np.argmin(graph.vertex_ids)]]
    factors, values = _factors(graph), gtsam.Values()
    for vertex, T in zip(graph.vertex_ids.tolist(), graph.T_world_vertex, strict=True):
        values.insert(vertex, _pose(T))
    prior = gtsam.PriorFactorPose2 if graph.is_planar else gtsam.PriorFactorPose3
    noise = gtsam.noiseModel.Isotropic.Sigma(3 if graph.is_planar else 6, FIXED_SIGMA)
    held_rows = graph.rows_of(held)
    for vertex, row in zip(held.tolist(), held_rows, strict=True):
        factors.add(prior(vertex, _pose(graph.T_world_vertex[row]), noise))
    try:
        solution = optimize_robustly(factors, values, np.flatnonzero(is_closure), max_iterations=max_iterations)
    except (RuntimeError, ValueError, IndexError) as error:
        first_line = next((line.strip() for line in str(error).splitlines() if line.strip()), type(error).__name__)
        raise FactorGraphError(f"the optimisation failed: {first_line}") from error
    at = solution.values.atPose2 if graph.is_planar else solution.values.atPose3
    poses = np.array([at(vertex).matrix() for vertex in graph.vertex_ids.tolist()])
    if not np.isfinite(poses).all():
        raise FactorGraphError("the optimisation failed: a pose is not finite; check the measurements")
    poses[held_rows] = graph.T_world_vertex[held_rows]
    return PoseGraphSolution(replace(graph, T_world_vertex=poses), is_closure, solution)


def _factors(graph: PoseGraph) -> gtsam.NonlinearFactorGraph:
    between = gtsam.BetweenFactorPose2 if graph.is_planar else gtsam.BetweenFactorPose3
    factors = gtsam.NonlinearFactorGraph()
    for (start, end), T, information in zip(graph.edges.tolist(), graph.T_from_to, graph.information, strict=True):
        factors.add(between(start, end, _pose(T), gtsam.noiseModel.Gaussian.Information(information)))
    return factors


def _pose(T: FloatArray) -> Any:
    """GTSAM's Pose2 of (3, 3), Pose3 of (4, 4)."""
    if len(T) == 4:
        return gtsam.Pose3(T)
    return gtsam.Pose2(T[0, 2], T[1, 2], np.arctan2(T[1, 0], T[0, 0]))
