"""Batch optimisation of a graph in which some factors are loop closures, and some of these are false."""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np

from slam.common.arrays import BoolArray, FloatArray, IntArray
from slam.common.errors import FactorGraphError

MAX_ITERATIONS = 100
MIN_DECREASE = 1e-5
"""Of the cost, in nats."""
KERNEL_WIDTH = 1.0
"""Width of the Cauchy kernels, in standard deviations of the whole, whitened error."""
WIDE_KERNEL_WIDTH = 10.0
"""Width at which many closures outweigh few that happen to fit the odometry."""
MIN_WEIGHT = 0.02
"""A closure whose weight is less is rejected: one that is off by more than seven standard deviations."""
DIMENSION = 6
"""Of the error between two poses."""


@dataclass(frozen=True, slots=True, eq=False)
class RobustSolution:
    """``weights`` (C,) in [0, 1], one for each closure: 1 fits exactly, 0 was rejected.

    ``message`` says what did not converge, and whether all closures were rejected; it may be empty.
    The errors are those of the factors in force at the end, through their kernels: at the initial values and at the
    solution. ``iterations`` are those of all solutions together.
    """

    values: gtsam.Values
    weights: FloatArray
    converged: bool
    message: str
    iterations: int
    error_before: float
    error_after: float

    @property
    def kept(self) -> BoolArray:
        """Whether each closure (C,) agrees with the solution."""
        return np.asarray(self.weights >= MIN_WEIGHT)


def optimize_robustly(
    graph: gtsam.NonlinearFactorGraph,
    initial: gtsam.Values,
    closures: IntArray,
    *,
    max_iterations: int = MAX_ITERATIONS,
    min_decrease: float = MIN_DECREASE,
) -> RobustSolution:
    """Solve a graph, and reject the false closures in it.

    All closures get a Cauchy kernel, whose weight falls with the square of the error (Black and Rangarajan 1996 on such
    kernels as outlier processes). Such a cost has many minima. Two are compared, near the solution without closures and
    near that with a wide kernel, and the lower one is used; so the initial values hardly matter. The weight never falls
    to zero, and hundreds of false closures pull together: those of little weight are rejected and the rest is solved
    again, until none is rejected.

    Args:
        graph: all factors; closures with plain Gaussian noise, others as they are, with kernels of their own or
            without. Slots may be empty. It must hold every variable without its closures. It is not changed.
        initial: a value for each variable.
        closures: (C,) indices of the factors that are closures; C may be 0.
        max_iterations: of one solution by Levenberg-Marquardt, of which there are several.
        min_decrease: of the cost, in nats: a solution ends with a step that lowers it by less.

    Raises:
        FactorGraphError: an index is not that of a factor between two poses with plain noise.
        RuntimeError: GTSAM cannot solve the graph, e.g. because only closures hold a variable.
    """
    solver = _Solver(graph, initial, closures, max_iterations, min_decrease)
    if len(closures) == 0:
        return solver.finish(solver.solve(np.zeros(0, dtype=np.bool_), initial), np.zeros(0, dtype=np.bool_))
    in_force = np.ones(len(closures), dtype=np.bool_)
    alone = solver.solve(~in_force, initial)
    starts = (alone, solver.solve(in_force, alone, WIDE_KERNEL_WIDTH))
    values = min((solver.solve(in_force, start) for start in starts), key=lambda each: solver.cost(each, in_force))
    while (rejected := in_force & (solver.weights(values) < MIN_WEIGHT)).any():
        in_force &= ~rejected
        values = solver.solve(in_force, values)
    return solver.finish(values, in_force)


class _Solver:
    """Solves a graph with some of its closures, and counts iterations."""

    def __init__(
        self,
        graph: gtsam.NonlinearFactorGraph,
        initial: gtsam.Values,
        closures: IntArray,
        max_iterations: int,
        min_decrease: float,
    ) -> None:
        self._closures = [_checked_closure(graph, index) for index in closures.tolist()]
        self._others = graph.clone()
        for index in closures.tolist():
            self._others.remove(index)
        self._initial = initial
        self._max_iterations = max_iterations
        self._min_decrease = min_decrease
        self._iterations = 0
        self._shortfalls: dict[str, None] = {}

    def solve(self, in_force: BoolArray, start: gtsam.Values, width: float = KERNEL_WIDTH) -> gtsam.Values:
        """The least cost of all other factors and the closures in force (C,), near ``start``."""
        parameters = gtsam.LevenbergMarquardtParams()
        parameters.setMaxIterations(self._max_iterations)
        parameters.setAbsoluteErrorTol(self._min_decrease)
        graph = self._graph(in_force, width)
        optimizer = gtsam.LevenbergMarquardtOptimizer(graph, start, parameters)
        values = optimizer.optimize()
        self._iterations += optimizer.iterations()
        what = f"the solution with {np.count_nonzero(in_force)} closures"
        if optimizer.iterations() >= self._max_iterations:
            self._shortfalls[f"{what} took all {self._max_iterations} iterations"] = None
        elif optimizer.lambda_() >= parameters.getlambdaUpperBound() and _could_be_lower(graph, values, parameters):
            self._shortfalls[f"{what} found no step that lowers its error of {optimizer.error():.6g}"] = None
        return values

    def cost(self, values: gtsam.Values, in_force: BoolArray) -> float:
        """Error of all other factors and of the closures in force (C,), through their kernels [nats]."""
        return float(self._graph(in_force).error(values))

    def weights(self, values: gtsam.Values) -> FloatArray:
        """Weight (C,) that the Cauchy kernel gives each closure, in (0, 1]."""
        chi_squared = np.array([2.0 * factor.error(values) for factor in self._closures], dtype=np.float64)
        return np.asarray(1.0 / (1.0 + chi_squared / KERNEL_WIDTH**2))

    def finish(self, values: gtsam.Values, in_force: BoolArray) -> RobustSolution:
        """The solution, with what is wrong with it."""
        notes = list(self._shortfalls)
        if len(in_force) and not in_force.any():
            notes.append(f"none of {len(in_force)} closures agrees with the rest; all were rejected")
        return RobustSolution(
            values=values,
            weights=np.where(in_force, self.weights(values), 0.0),
            converged=not self._shortfalls,
            message="; ".join(notes),
            iterations=self._iterations,
            error_before=self.cost(self._initial, in_force),
            error_after=self.cost(values, in_force),
        )

    def _graph(self, in_force: BoolArray, width: float = KERNEL_WIDTH) -> gtsam.NonlinearFactorGraph:
        graph = self._others.clone()
        for row in np.flatnonzero(in_force).tolist():
            graph.add(_with_kernel(self._closures[row], width))
        return graph


def _could_be_lower(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, parameters: gtsam.LevenbergMarquardtParams
) -> bool:
    """Whether a full step promises more than the tolerances: the damping also runs away at the very minimum.

    Where the system is too badly conditioned for a full step, it may be.
    """
    linear = graph.linearize(values)
    error = graph.error(values)
    try:
        promised = error - linear.error(linear.optimize())
    except RuntimeError:  # GTSAM: indeterminate linear system
        return True
    return bool(promised > parameters.getAbsoluteErrorTol() + parameters.getRelativeErrorTol() * error)


def _checked_closure(graph: gtsam.NonlinearFactorGraph, index: int) -> gtsam.NoiseModelFactor:
    factor = graph.at(index) if 0 <= index < graph.size() and graph.exists(index) else None
    if not isinstance(factor, gtsam.NoiseModelFactor) or len(factor.keys()) != 2 or factor.dim() != DIMENSION:
        raise FactorGraphError(f"factor {index} is not a closure between two poses")
    if isinstance(factor.noiseModel(), gtsam.noiseModel.Robust):
        raise FactorGraphError(f"closure {index} has a kernel already; give it plain noise")
    return factor


def _with_kernel(factor: gtsam.NoiseModelFactor, width: float) -> gtsam.NoiseModelFactor:
    kernel = gtsam.noiseModel.mEstimator.Cauchy.Create(width)
    return factor.cloneWithNewNoiseModel(gtsam.noiseModel.Robust.Create(kernel, factor.noiseModel()))
