"""Batch optimisation of a graph in which some factors are loop closures, and some of these are false.

How well it does so ``slam.benchmarks.closures`` measures.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass

import gtsam
import numpy as np

from slam.common.arrays import BoolArray, FloatArray, IntArray
from slam.common.errors import FactorGraphError

logger = logging.getLogger(__name__)


MAX_ITERATIONS = 100
LEAST_DECREASE = 1e-5
"""Of the cost, in nats."""
MAX_ROUNDS = 20
KERNEL_WIDTH = 1.0
"""Width of the Cauchy kernel in standard deviations of the whole, whitened error."""
WIDER = (10.0, 5.0, 2.0)
"""Widths by which the kernel is narrowed where many closures are in dispute."""
CLEAR_SHARE = 0.8
"""If that share of the closures in force is kept, nothing is in dispute."""
LEAST_WEIGHT = 1e-4
"""A closure whose weight is less is taken out: with this width one that is a hundred standard deviations off."""
KEPT_WEIGHT = 0.02
"""A closure whose weight is at least that counts as kept: one within seven standard deviations."""
LEAST_AGREEMENT = 1.0 / 6.0
"""At least that share of the closures that fit all other factors must be kept, or all of them are rejected."""
LEAST_SHARE = 0.1
"""At least that share of all closures must be kept: of hundreds of false ones a stretch of street may fit by chance."""
INFLATION = 3.0
"""How many times the standard deviations of all other factors may be too small before a closure does not fit them."""
FIT_QUANTILE = {3: 16.27, 6: 22.46}
"""99.9 % of the chi-squared distribution by its degrees of freedom."""
MAX_SAMPLED = 60
"""Closures sampled to estimate how many agree with all other factors."""


@dataclass(frozen=True, slots=True, eq=False)
class RobustSolution:
    """``weights`` (C,) in [0, 1], one for each closure: 1 fits exactly, 0 was taken out.

    ``message`` says what did not converge, and whether all closures were rejected; it may be empty.
    The errors are those of the factors in force at the end, closures through their kernel: at the initial values and at
    the solution. ``iterations`` are those of all solutions together.
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
        """Whether each closure (C,) agrees with the solution; one that does not may still have a small weight."""
        return np.asarray(self.weights >= KEPT_WEIGHT)


def optimize_robustly(
    graph: gtsam.NonlinearFactorGraph,
    initial: gtsam.Values,
    closures: IntArray,
    *,
    max_iterations: int = MAX_ITERATIONS,
    least_decrease: float = LEAST_DECREASE,
) -> RobustSolution:
    """Solve a graph, and reject the false closures in it.

    All closures get a Cauchy kernel: its weight falls with the square of the error (Black and Rangarajan 1996 on such
    kernels as outlier processes). It never falls to zero, though, and hundreds of false closures pull together;
    therefore those of almost no weight are taken out and the rest is solved again, until none is left to take out. It
    begins at the solution without closures, so that the initial values hardly matter.

    False closures that fit all other factors, e.g. wrong by one house, are in dispute with the true ones, and which
    side a narrow kernel takes depends on where it begins. Where there are many, a kernel that begins wide and becomes
    narrow is tried as well (graduated non-convexity, Yang et al. 2020), and the lower cost wins. If few of those that
    fit all other factors are kept in the end, these agree by chance, and all are rejected: better the drift of the
    odometry than a false loop.

    Args:
        graph: all factors; closures with plain Gaussian noise, others as they are, with kernels of their own or
            without. Slots may be empty. It must hold every variable without its closures. It is not changed.
        initial: a value for each variable.
        closures: (C,) indices of the factors that are closures; C may be 0.
        max_iterations: of one solution by Levenberg-Marquardt, of which there are several.
        least_decrease: of the cost, in nats: a solution ends with a step that lowers it by less.

    Raises:
        FactorGraphError: an index is none of a factor between two poses with plain noise.
        RuntimeError: GTSAM cannot solve the graph, e.g. because something hangs on closures only.
    """
    solver = _Solver(graph, initial, closures, max_iterations, least_decrease)
    none_kept = np.zeros(len(closures), dtype=np.bool_)
    alone = solver.solve(none_kept, initial, "the solution without closures" if len(closures) else "the solution")
    if len(closures) == 0:
        return solver.finish(alone, none_kept, "")
    values, in_force = solver.solve_and_reject(alone)
    kept = in_force & (solver.weights(values) >= KEPT_WEIGHT)
    if 0 < np.count_nonzero(kept) < CLEAR_SHARE * np.count_nonzero(in_force):
        narrowed = solver.solve_narrowing(in_force, alone)
        values = min(values, narrowed, key=lambda each: solver.cost(each, in_force))
        kept = in_force & (solver.weights(values) >= KEPT_WEIGHT)
    if solver.agree(kept, alone):
        return solver.finish(values, in_force, "")
    many = f"only {np.count_nonzero(kept)}" if kept.any() else "none"
    return solver.finish(alone, none_kept, f"{many} of {len(kept)} closures agree with the rest; all were rejected")


class _Solver:
    """Solves a graph with some of its closures, and keeps count."""

    def __init__(
        self,
        graph: gtsam.NonlinearFactorGraph,
        initial: gtsam.Values,
        closures: IntArray,
        max_iterations: int,
        least_decrease: float,
    ) -> None:
        self._indices = [int(index) for index in closures]
        self._plain = [_closure(graph, index) for index in self._indices]
        self._others = graph.clone()
        for index in self._indices:
            self._others.remove(index)
        self._initial = initial
        self._max_iterations = max_iterations
        self._least_decrease = least_decrease
        self._iterations = 0
        self._shortfalls: list[str] = []

    def solve(self, in_force: BoolArray, start: gtsam.Values, what: str, width: float = KERNEL_WIDTH) -> gtsam.Values:
        """The least cost of all other factors and the closures in force (C,), near ``start``."""
        parameters = gtsam.LevenbergMarquardtParams()
        parameters.setMaxIterations(self._max_iterations)
        parameters.setAbsoluteErrorTol(self._least_decrease)
        graph = self._graph(in_force, width)
        optimizer = gtsam.LevenbergMarquardtOptimizer(graph, start, parameters)
        values = optimizer.optimize()
        self._iterations += optimizer.iterations()
        if optimizer.iterations() >= self._max_iterations:
            self._shortfalls.append(f"{what} took all {self._max_iterations} iterations")
        elif optimizer.lambda_() >= parameters.getlambdaUpperBound() and _could_be_lower(graph, values, parameters):
            self._shortfalls.append(f"{what} found no step that lowers its error of {optimizer.error():.6g}")
        return values

    def solve_and_reject(self, start: gtsam.Values) -> tuple[gtsam.Values, BoolArray]:
        """Solve with all closures, take out those of almost no weight, and so on; values and what is in force (C,)."""
        in_force = np.ones(len(self._plain), dtype=np.bool_)
        values = start
        for turn in range(1, MAX_ROUNDS + 1):
            values = self.solve(in_force, values, f"round {turn} of the rejection")
            bad = in_force & (self.weights(values) < LEAST_WEIGHT)
            if not bad.any():
                return values, in_force
            in_force = in_force & ~bad
            logger.debug("round %d: %d of %d closures left", turn, np.count_nonzero(in_force), len(in_force))
        self._shortfalls.append(f"closures were still being taken out after {MAX_ROUNDS} rounds")
        return self.solve(in_force, values, "the last round of the rejection"), in_force

    def solve_narrowing(self, in_force: BoolArray, start: gtsam.Values) -> gtsam.Values:
        """Solve with the closures in force (C,) under a wide kernel, then under narrower and narrower ones."""
        values = start
        for width in (*WIDER, KERNEL_WIDTH):
            values = self.solve(in_force, values, f"the solution with a kernel of width {width:g}", width)
        return values

    def cost(self, values: gtsam.Values, in_force: BoolArray) -> float:
        """Error of all other factors and, through their kernel, of the closures in force (C,)."""
        return float(self._graph(in_force).error(values))

    def agree(self, kept: BoolArray, alone: gtsam.Values) -> bool:
        """Whether the kept closures (C,) are more than chance.

        A large share of all is, a tiny one is not; in between they must fit ``alone``, the solution without closures,
        and be a large share of all that do.
        """
        share = float(np.mean(kept))
        if share < LEAST_SHARE or share >= LEAST_AGREEMENT:
            return share >= LEAST_SHARE
        try:
            marginals = gtsam.Marginals(self._others, alone)
            support, contradiction = (self._count_fitting(rows, alone, marginals) for rows in (kept, ~kept))
        except RuntimeError as error:
            logger.info("no covariance without closures (%s); they are not tested against it", error)
            return True
        return bool(support >= 0.5 * np.count_nonzero(kept) and support >= LEAST_AGREEMENT * (support + contradiction))

    def _count_fitting(self, which: BoolArray, alone: gtsam.Values, marginals: gtsam.Marginals) -> float:
        """About how many of some closures (C,) fit all other factors; a sample stands for many."""
        rows = np.flatnonzero(which)
        sampled = rows[np.linspace(0, len(rows) - 1, min(len(rows), MAX_SAMPLED)).astype(np.int64)]
        misfits = np.array([_misfit(self._plain[row], alone, marginals) for row in sampled])
        gates = np.array([FIT_QUANTILE[self._plain[row].dim()] for row in sampled])
        return len(rows) * float(np.mean(misfits < gates))

    def finish(self, values: gtsam.Values, in_force: BoolArray, note: str) -> RobustSolution:
        """Warnings about a solution."""
        return RobustSolution(
            values=values,
            weights=np.where(in_force, self.weights(values), 0.0),
            converged=not self._shortfalls,
            message="; ".join([*dict.fromkeys(self._shortfalls), *([note] if note else [])]),
            iterations=self._iterations,
            error_before=self.cost(self._initial, in_force),
            error_after=self.cost(values, in_force),
        )

    def weights(self, values: gtsam.Values) -> FloatArray:
        """Weight (C,) that the Cauchy kernel gives each closure, in (0, 1]."""
        chi_squared = np.array([2.0 * factor.error(values) for factor in self._plain], dtype=np.float64)
        return np.asarray(1.0 / (1.0 + chi_squared / KERNEL_WIDTH**2))

    def _graph(self, in_force: BoolArray, width: float = KERNEL_WIDTH) -> gtsam.NonlinearFactorGraph:
        graph = self._others.clone()
        for row in np.flatnonzero(in_force):
            graph.replace(self._indices[row], _with_kernel(self._plain[row], width))
        return graph


def _could_be_lower(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, parameters: gtsam.LevenbergMarquardtParams
) -> bool:
    """Whether a full step promises more than the tolerances: the damping also runs away at the very minimum."""
    linear = graph.linearize(values)
    step = linear.optimize()
    error = graph.error(values)
    promised = error - linear.error(step)
    return bool(promised > parameters.getAbsoluteErrorTol() + parameters.getRelativeErrorTol() * error)


def _closure(graph: gtsam.NonlinearFactorGraph, index: int) -> gtsam.NoiseModelFactor:
    factor = graph.at(index) if 0 <= index < graph.size() and graph.exists(index) else None
    if not isinstance(factor, gtsam.NoiseModelFactor) or len(factor.keys()) != 2 or factor.dim() not in FIT_QUANTILE:
        raise FactorGraphError(f"factor {index} is no closure between two poses")
    if isinstance(factor.noiseModel(), gtsam.noiseModel.Robust):
        raise FactorGraphError(f"closure {index} has a kernel already; give it plain noise")
    return factor


def _with_kernel(factor: gtsam.NoiseModelFactor, width: float) -> gtsam.NoiseModelFactor:
    kernel = gtsam.noiseModel.mEstimator.Cauchy.Create(width)
    return factor.cloneWithNewNoiseModel(gtsam.noiseModel.Robust.Create(kernel, factor.noiseModel()))


def _misfit(closure: gtsam.NoiseModelFactor, alone: gtsam.Values, marginals: gtsam.Marginals) -> float:
    """Squared Mahalanobis distance, to first order, by the inflated other factors and the closure's own noise."""
    J, residual = closure.linearize(alone).jacobian()  # both whitened
    covariance = marginals.jointMarginalCovariance(closure.keys()).fullMatrix()
    innovation = INFLATION**2 * J @ covariance @ J.T + np.eye(len(residual))
    return float(residual @ np.linalg.solve(innovation, residual))
