"""Batch optimisation of poses with edges between them, of which some are loop closures, and some of these are false."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X

from slam.backend.batch_solver import levenberg_marquardt
from slam.backend.factors import CLOSURE_KERNEL_WIDTH, Edge, EdgeKind, PosePrior, between_factor, prior_factor
from slam.backend.gtsam_calls import gtsam_errors
from slam.common.arrays import BoolArray, FloatArray

WIDE_KERNEL_WIDTH = 10.0
"""Width at which many closures outweigh few that happen to fit the odometry."""
MIN_WEIGHT = 0.02
"""A closure whose weight is less is rejected: one that is off by more than seven standard deviations."""


@dataclass(frozen=True, slots=True, eq=False)
class PoseGraphSolution:
    """``T_map_body`` (K, 4, 4) of the keyframes in their order, and whether each closure (C,) is ``kept``: it agrees
    with the solution.
    """

    T_map_body: FloatArray
    kept: BoolArray


def optimize_pose_graph(
    T_map_body: Mapping[int, FloatArray], factors: Iterable[PosePrior | Edge], closures: Sequence[Edge]
) -> PoseGraphSolution:
    """Solve a pose graph, and reject the false closures in it.

    All closures get a Cauchy kernel, whose weight falls with the square of the error (Black and Rangarajan 1996 on such
    kernels as outlier processes). Such a cost has many minima. Two are compared, near the solution without closures and
    near that with a wide kernel, and the lower one is used; so the initial values hardly matter. The weight never falls
    to zero, and hundreds of false closures pull together: those of little weight are rejected and the rest is solved
    again, until none is rejected.

    Args:
        T_map_body: initial values (4, 4) by keyframe.
        factors: what holds all poses without the closures.
        closures: edges that may be false; there may be none.

    Raises:
        FactorGraphError: GTSAM cannot solve the graph, for example because a keyframe has no initial value.
    """
    initial = gtsam.Values()
    for keyframe, T in T_map_body.items():
        initial.insert(X(keyframe), gtsam.Pose3(T))
    with gtsam_errors("the optimisation of the pose graph"):
        solver = _Solver(factors, closures)
        in_force = np.ones(len(closures), dtype=np.bool_)
        values = solver.solve(~in_force, initial)
        if len(closures):
            starts = (values, solver.solve(in_force, values, WIDE_KERNEL_WIDTH))
            solutions = [solver.solve(in_force, start) for start in starts]
            values = min(solutions, key=lambda each: solver.graph(in_force).error(each))
        while (rejected := in_force & (solver.weights(values) < MIN_WEIGHT)).any():
            in_force &= ~rejected
            values = solver.solve(in_force, values)
    poses = np.array([values.atPose3(X(keyframe)).matrix() for keyframe in T_map_body]).reshape(-1, 4, 4)
    return PoseGraphSolution(poses, in_force)


class _Solver:
    """Solves a graph with some of its closures."""

    def __init__(self, factors: Iterable[PosePrior | Edge], closures: Sequence[Edge]) -> None:
        self._others = gtsam.NonlinearFactorGraph()
        for each in factors:
            self._others.add(between_factor(each) if isinstance(each, Edge) else prior_factor(each))
        # Without the kernel that closures have.
        self._closures = [between_factor(replace(each, kind=EdgeKind.ODOMETRY)) for each in closures]

    def solve(self, in_force: BoolArray, start: gtsam.Values, width: float = CLOSURE_KERNEL_WIDTH) -> gtsam.Values:
        """The least cost of all other factors and the closures in force (C,), near ``start``."""
        return levenberg_marquardt(self.graph(in_force, width), start).optimize()

    def graph(self, in_force: BoolArray, width: float = CLOSURE_KERNEL_WIDTH) -> gtsam.NonlinearFactorGraph:
        """All other factors, and the closures in force (C,) with kernels of that width in standard deviations."""
        graph, kernel = self._others.clone(), gtsam.noiseModel.mEstimator.Cauchy.Create(width)
        for row in np.flatnonzero(in_force).tolist():
            closure = self._closures[row]
            graph.add(closure.cloneWithNewNoiseModel(gtsam.noiseModel.Robust.Create(kernel, closure.noiseModel())))
        return graph

    def weights(self, values: gtsam.Values) -> FloatArray:
        """Weight (C,) that the Cauchy kernel gives each closure, in (0, 1]."""
        chi_squared = np.array([2.0 * closure.error(values) for closure in self._closures], dtype=np.float64)
        return np.asarray(1.0 / (1.0 + chi_squared / CLOSURE_KERNEL_WIDTH**2))
