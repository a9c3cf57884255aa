"""The solver at the end of a drive: the whole graph at once, by Levenberg-Marquardt."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import gtsam
from gtsam.symbol_shorthand import X

from slam.backend.gtsam_calls import graph_of, gtsam_errors
from slam.backend.solver import Solver, Value

MAX_ITERATIONS = 50
MIN_DECREASE = 0.005
"""Of the cost, in nats: the next step would move all variables together by a tenth of a standard deviation."""
ROUGH_MIN_DECREASE = 0.5
"""The same by one standard deviation: the steps that follow are short ones, on which no fusion of landmarks depends."""


def levenberg_marquardt(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    max_iterations: int = MAX_ITERATIONS,
    min_decrease: float = MIN_DECREASE,
) -> gtsam.LevenbergMarquardtOptimizer:
    """The optimiser of a graph from ``values``; it ends with a step that lowers the cost by less than the decrease."""
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(max_iterations)
    parameters.setAbsoluteErrorTol(min_decrease)
    return gtsam.LevenbergMarquardtOptimizer(graph, values, parameters)


@dataclass(frozen=True, slots=True)
class Optimization:
    """How the batch optimisation ended; ``error``: the cost at its end, in nats."""

    converged: bool
    iterations: int
    error: float


class BatchSolver(Solver):
    """All factors, and values of all variables, which ``update`` improves by one step."""

    def __init__(self, factors: Mapping[int, gtsam.NonlinearFactor], values: gtsam.Values) -> None:
        super().__init__()
        self._values = values
        for number, factor in factors.items():
            self.add(number, factor)
        self._note_update()

    def holds(self, key: int) -> bool:
        """Whether a variable is there."""
        return bool(self._values.exists(key))

    def insert(self, key: int, value: Value) -> None:
        """Add a variable with its initial value."""
        self._values.insert(key, value)

    def optimize(self, *, roughly: bool = False) -> Optimization:
        """Solve to the end, or ``roughly``, to a standard deviation."""
        with gtsam_errors("the batch optimisation"):
            optimization = self._optimize(MAX_ITERATIONS, ROUGH_MIN_DECREASE if roughly else MIN_DECREASE)
        self._note_update()
        return optimization

    def log_determinant(self) -> float:
        """Of the information of all variables together."""
        with gtsam_errors("the elimination of all variables"):
            return 2.0 * float(self.graph.linearize(self._values).eliminateMultifrontal().logDeterminant())

    def values(self) -> gtsam.Values:
        """The estimate of all variables, as of the last step."""
        return self._values

    @property
    def graph(self) -> gtsam.NonlinearFactorGraph:
        """All factors, in the order of ``factors``."""
        return graph_of(self._factors.values())

    def _optimize(self, max_iterations: int, min_decrease: float) -> Optimization:
        optimizer = levenberg_marquardt(self.graph, self._values, max_iterations, min_decrease)
        self._values = optimizer.optimize()
        iterations = optimizer.iterations()
        return Optimization(iterations < max_iterations, iterations, optimizer.error())

    def _start(self, values: gtsam.Values) -> None:
        self._values = gtsam.Values(values)
        self._improve()

    def _improve(self) -> None:
        with gtsam_errors("a step of the batch optimisation"):
            self._optimize(1, MIN_DECREASE)

    def _release(self, key: int) -> None:
        self._values.erase(key)

    def _pose(self, keyframe: int) -> gtsam.Pose3:
        return self._values.atPose3(X(keyframe))
