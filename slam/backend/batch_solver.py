"""The solver at the end of a drive: the whole graph at once, by Levenberg-Marquardt."""

from __future__ import annotations

import re
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X

from slam.backend.estimates import Estimates, read_estimates
from slam.common.arrays import FloatArray
from slam.common.errors import FactorGraphError

MAX_ITERATIONS = 50
LEAST_DECREASE = 0.005
"""Of the cost, in nats: the next step would move all variables together by a tenth of a standard deviation."""
ROUGH_DECREASE = 0.5
"""The same by one standard deviation: the steps that follow are short ones, on which no fusion of landmarks depends."""


class GtsamCalls:
    """Measures the time inside GTSAM, ``seconds``, and converts its exceptions to ``FactorGraphError``."""

    def __init__(self) -> None:
        self.seconds = 0.0

    @contextmanager
    def doing(self, what: str) -> Iterator[None]:
        """The block calls GTSAM for ``what``, which goes into the error with the keyframe or landmark it concerns."""
        started = time.perf_counter()
        try:
            yield
        except (RuntimeError, ValueError, IndexError) as error:
            raise FactorGraphError(f"{what} failed{_variable_in(str(error))}: {first_line(error)}") from error
        finally:
            self.seconds += time.perf_counter() - started


def first_line(error: Exception) -> str:
    """The first line of what an exception says."""
    return next((line.strip() for line in str(error).splitlines() if line.strip()), type(error).__name__)


def _variable_in(message: str) -> str:
    """The keyframe or landmark that a GTSAM message names as a symbol, e.g. x12 or l7."""
    found = re.search(r"\b([xl])(\d+)\b", message)
    if found is None:
        return ""
    return f" at {'keyframe' if found[1] == 'x' else 'landmark'} {found[2]}"


@dataclass(frozen=True, slots=True)
class Optimization:
    """How the batch optimisation ended."""

    converged: bool
    iterations: int
    error_before: float
    error_after: float


class BatchSolver:
    """All factors by their numbers, and the values of all variables, which ``update`` improves by one step."""

    def __init__(self, factors: Mapping[int, gtsam.NonlinearFactor], values: gtsam.Values, calls: GtsamCalls) -> None:
        self._factors = dict(factors)
        self._values = values
        self._calls = calls
        self._uses = Counter(key for factor in factors.values() for key in _keys(factor))
        self._is_changed = False

    def holds_keyframe(self, keyframe: int) -> bool:
        """Whether a keyframe is among the variables."""
        return bool(self._values.exists(X(keyframe)))

    def holds_landmark(self, landmark: int) -> bool:
        """Whether a landmark is among the variables."""
        return bool(self._values.exists(L(landmark)))

    def insert_keyframe(self, keyframe: int, T_map_body: gtsam.Pose3) -> None:
        """Add a keyframe, with its initial pose."""
        self._values.insert(X(keyframe), T_map_body)

    def insert_landmark(self, landmark: int, position_map: FloatArray) -> None:
        """Add a landmark, with its initial position (3,) m."""
        self._values.insert(L(landmark), position_map)

    def add(self, number: int, factor: gtsam.NonlinearFactor) -> None:
        """Add a factor."""
        self._factors[number] = factor
        self._uses.update(_keys(factor))
        self._is_changed = True

    def add_observation(
        self, number: int, factor: gtsam.NonlinearFactor, _keyframe: int, landmark: int, position_map: FloatArray
    ) -> None:
        """Add an observation of a landmark, which has the position (3,) m if it is new."""
        if not self.holds_landmark(landmark):
            self.insert_landmark(landmark, position_map)
        self.add(number, factor)

    def remove(self, number: int) -> None:
        """Take a factor out again; a variable leaves with its last one."""
        for key in _keys(self._factors.pop(number)):
            self._uses[key] -= 1
            if not self._uses[key]:
                self._values.erase(key)
        self._is_changed = True

    def update(self) -> None:
        """Improve the values by one step, if anything changed."""
        if self._is_changed:
            with self._calls.doing("a step of the batch optimisation"):
                self._optimize(1, LEAST_DECREASE)

    def restart(self, values: gtsam.Values, changed: Mapping[int, gtsam.NonlinearFactor]) -> None:
        """Go on from other values, with factors added, or others in the place of some."""
        for number, factor in changed.items():
            self._uses.subtract(_keys(self._factors[number]) if number in self._factors else ())
            self._uses.update(_keys(factor))
        self._factors |= changed
        self._values, self._is_changed = gtsam.Values(values), True
        self.update()

    def optimize(self, *, roughly: bool = False) -> Optimization:
        """Solve to the end, or ``roughly``, to a standard deviation."""
        with self._calls.doing("the batch optimisation"):
            return self._optimize(MAX_ITERATIONS, ROUGH_DECREASE if roughly else LEAST_DECREASE)

    def _optimize(self, max_iterations: int, least_decrease: float) -> Optimization:
        parameters = gtsam.LevenbergMarquardtParams()
        parameters.setMaxIterations(max_iterations)
        parameters.setAbsoluteErrorTol(least_decrease)
        optimizer = gtsam.LevenbergMarquardtOptimizer(self.graph, self._values, parameters)
        error_before = optimizer.error()
        self._values = optimizer.optimize()
        self._is_changed = False
        iterations = optimizer.iterations()
        return Optimization(iterations < max_iterations, iterations, error_before, optimizer.error())

    def pose(self, keyframe: int) -> FloatArray:
        """``T_map_body`` (4, 4) of a keyframe."""
        if not self.holds_keyframe(keyframe):
            raise FactorGraphError(f"keyframe {keyframe} is not in the graph")
        return np.asarray(self._values.atPose3(X(keyframe)).matrix())

    def point(self, landmark: int) -> FloatArray:
        """Position (3,) m of a landmark."""
        return np.asarray(self._values.atPoint3(L(landmark)))

    def estimate(self) -> gtsam.Values:
        """All variables as of the last step."""
        return self._values

    def estimates(self) -> Estimates:
        """All positions as of the last step."""
        return read_estimates(self._values)

    def settle(self, landmarks: Mapping[int, FloatArray]) -> BatchSolver:
        """This one."""
        return self

    @property
    def factors(self) -> Mapping[int, gtsam.NonlinearFactor]:
        """All factors, by their numbers."""
        return self._factors

    @property
    def numbers(self) -> list[int]:
        """The factors, in the order of ``graph``."""
        return list(self._factors)

    @property
    def graph(self) -> gtsam.NonlinearFactorGraph:
        """All factors."""
        return graph_of(self._factors.values())


def graph_of(factors: Iterable[gtsam.NonlinearFactor]) -> gtsam.NonlinearFactorGraph:
    """A graph of some factors, in their order."""
    graph = gtsam.NonlinearFactorGraph()
    for factor in factors:
        graph.add(factor)
    return graph


def _keys(factor: gtsam.NonlinearFactor) -> list[int]:
    return list(factor.keys())
