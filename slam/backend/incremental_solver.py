"""The solver: iSAM2 while the drive goes on, Levenberg-Marquardt at its end.

Errors of GTSAM become ``FactorGraphError`` with the keyframe or landmark they concern.
"""

from __future__ import annotations

import logging
import re
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X

from slam.backend.estimates import Estimates, read_estimates
from slam.common.arrays import FloatArray
from slam.common.config import FactorGraphConfig
from slam.common.errors import FactorGraphError

logger = logging.getLogger(__name__)

MAX_BATCH_ITERATIONS = 50
RELINEARIZE_UNIT_RANGES = 1.0 / 30.0
"""Unit of length in which a position changes by as much as a rotation in radians, in sensor ranges."""


@dataclass(frozen=True, slots=True)
class Optimization:
    """How the batch optimisation ended."""

    converged: bool
    iterations: int
    error_before: float
    error_after: float


class IncrementalSolver:
    """iSAM2 (Kaess et al. 2012), and what it takes in with its next update; ``seconds`` is the time inside GTSAM.

    Each factor has a number of the caller's, which never changes.
    """

    def __init__(self, config: FactorGraphConfig, *, sensor_range_m: float) -> None:
        self._config = config
        self._relinearize_unit_m = RELINEARIZE_UNIT_RANGES * sensor_range_m
        self._isam = self._new_isam("CHOLESKY")
        self._values: gtsam.Values | None = None
        self._pending: dict[int, gtsam.NonlinearFactor] = {}
        self._pending_values = gtsam.Values()
        self._slots: dict[int, int] = {}
        self._removed_slots: list[int] = []
        self._leaving: set[int] = set()
        self.seconds = 0.0

    def holds_keyframe(self, keyframe: int) -> bool:
        """Whether a keyframe is among the variables."""
        return self._pending_values.exists(X(keyframe)) or self._isam.valueExists(X(keyframe))

    def insert_keyframe(self, keyframe: int, T_map_body: gtsam.Pose3) -> None:
        """Add a keyframe, with its initial pose."""
        self._pending_values.insert(X(keyframe), T_map_body)

    def insert_landmark(self, landmark: int, position_map: FloatArray) -> None:
        """Add a landmark, with its initial position (3,) m; one that was about to leave stays where it was."""
        if landmark in self._leaving:
            self._leaving.remove(landmark)
        else:
            self._pending_values.insert(L(landmark), position_map)

    def release_landmark(self, landmark: int) -> None:
        """A landmark without factors leaves."""
        if self._pending_values.exists(L(landmark)):
            self._pending_values.erase(L(landmark))
        else:
            self._leaving.add(landmark)

    def add(self, number: int, factor: gtsam.NonlinearFactor) -> None:
        """Add a factor."""
        self._pending[number] = factor

    def remove(self, number: int) -> None:
        """Take a factor out again."""
        if number in self._pending:
            del self._pending[number]
        else:
            self._removed_slots.append(self._slots.pop(number))

    def update(self) -> None:
        """Bring the incremental estimate up to date with all that was added and removed."""
        if not self._pending and not self._removed_slots:
            return
        with self.timed("the incremental update"):
            try:
                new = _graph_of(self._pending)
                result = self._isam.update(new, self._pending_values, self._removed_slots)
                numbers = list(self._pending)
            except RuntimeError as error:
                logger.info("the incremental update failed (%s); solving afresh by QR", _first_line(error))
                numbers = sorted([*self._slots, *self._pending])
                # The failed update has taken the new variables in already.
                result = self._start_over(self._factors(), self._isam.getLinearizationPoint(), "QR")
            self._values = None
        self._took_in(numbers, result)

    def restart(self, values: gtsam.Values, changed: Mapping[int, gtsam.NonlinearFactor]) -> None:
        """Solve all afresh from ``values``, with other factors in the place of some."""
        self.update()
        factors = self._factors() | dict(changed)
        try:
            result = self._start_over(factors, values, "CHOLESKY")
        except RuntimeError as error:
            logger.info("joining by Cholesky failed (%s); solving afresh by QR", _first_line(error))
            result = self._start_over(factors, values, "QR")
        self._values = None
        self._slots = {}
        self._took_in(list(factors), result)

    def optimize(self) -> Optimization:
        """Solve the whole graph at once, from the incremental estimate, by Levenberg-Marquardt."""
        self.update()
        with self.timed("the batch optimisation"):
            graph = self._isam.getFactorsUnsafe().clone()
            parameters = gtsam.LevenbergMarquardtParams()
            parameters.setMaxIterations(MAX_BATCH_ITERATIONS)
            optimizer = gtsam.LevenbergMarquardtOptimizer(graph, self.estimate(), parameters)
            error_before = optimizer.error()
            self._values = optimizer.optimize()
        return Optimization(
            optimizer.iterations() < MAX_BATCH_ITERATIONS, optimizer.iterations(), error_before, optimizer.error()
        )

    def pose(self, keyframe: int) -> FloatArray:
        """``T_map_body`` (4, 4) of a keyframe."""
        key = X(keyframe)
        if self._pending_values.exists(key):
            return np.asarray(self._pending_values.atPose3(key).matrix())
        if not self._isam.valueExists(key):
            raise FactorGraphError(f"keyframe {keyframe} is not in the graph")
        if self._values is not None:
            return np.asarray(self._values.atPose3(key).matrix())
        with self.timed(f"the estimate of keyframe {keyframe}"):
            return np.asarray(self._isam.calculateEstimatePose3(key).matrix())

    def estimate(self) -> gtsam.Values:
        """All variables as of the last update; iSAM2 computes those not queried before only here."""
        if self._values is None:
            with self.timed("the estimate"):
                self._values = self._isam.calculateEstimate()
        return self._values

    def estimates(self) -> Estimates:
        """Where everything is as far as it is known now; nothing is solved for it."""
        return read_estimates(self.estimate(), self._pending_values)

    @property
    def isam(self) -> gtsam.ISAM2:
        """The solver itself, as of the last update."""
        return self._isam

    @property
    def numbers(self) -> list[int]:
        """The factors of the last update, in the order in which the solver holds them."""
        return sorted(self._slots, key=self._slots.__getitem__)

    @contextmanager
    def timed(self, doing: str) -> Iterator[None]:
        """Measure the time inside GTSAM, and convert its exceptions to ``FactorGraphError``."""
        started = time.perf_counter()
        try:
            yield
        except (RuntimeError, ValueError, IndexError) as error:
            raise FactorGraphError(f"{doing} failed{_variable_in(str(error))}: {_first_line(error)}") from error
        finally:
            self.seconds += time.perf_counter() - started

    def _factors(self) -> dict[int, gtsam.NonlinearFactor]:
        """All factors in force, by their numbers, which ascend."""
        held = self._isam.getFactorsUnsafe()
        factors = {number: held.at(slot) for number, slot in self._slots.items()} | self._pending
        return {number: factors[number] for number in sorted(factors)}

    def _start_over(
        self, factors: Mapping[int, gtsam.NonlinearFactor], values: gtsam.Values, factorization: str
    ) -> gtsam.ISAM2Result:
        """Put all factors into a fresh iSAM2.

        One that eliminates by QR is slower than Cholesky, but it bears the poor conditioning of, say, a very sure
        odometry beside landmarks that the robust kernel has all but switched off.
        """
        graph, kept = _graph_of(factors), gtsam.Values()
        for key in graph.keyVector():
            if gtsam.symbolChr(key) == ord("x"):
                kept.insert(key, values.atPose3(key))
            else:
                kept.insert(key, values.atPoint3(key))
        self._isam = self._new_isam(factorization)
        return self._isam.update(graph, kept)

    def _took_in(self, numbers: list[int], result: gtsam.ISAM2Result) -> None:
        self._slots.update(zip(numbers, result.getNewFactorsIndices(), strict=True))
        self._pending = {}
        self._pending_values = gtsam.Values()
        self._removed_slots = []
        self._leaving.clear()

    def _new_isam(self, factorization: str) -> gtsam.ISAM2:
        """An empty one, with thresholds in radians and in units of length that are a fraction of the sensor range."""
        rotation = self._config.relinearize_threshold
        translation = rotation * self._relinearize_unit_m
        thresholds = gtsam.ISAM2ThresholdMap()
        thresholds.insert(("x", np.repeat([rotation, translation], 3)))
        thresholds.insert(("l", np.repeat(translation, 3)))
        parameters = gtsam.ISAM2Params()
        parameters.setRelinearizeThreshold(thresholds)
        parameters.relinearizeSkip = self._config.relinearize_skip
        parameters.setFactorization(factorization)
        return gtsam.ISAM2(parameters)


def _graph_of(factors: Mapping[int, gtsam.NonlinearFactor]) -> gtsam.NonlinearFactorGraph:
    graph = gtsam.NonlinearFactorGraph()
    for factor in factors.values():
        graph.add(factor)
    return graph


def _variable_in(message: str) -> str:
    """The keyframe or landmark that a GTSAM message names as a symbol, e.g. x12 or l7."""
    found = re.search(r"\b([xl])(\d+)\b", message)
    if found is None:
        return ""
    return f" at {'keyframe' if found[1] == 'x' else 'landmark'} {found[2]}"


def _first_line(error: Exception) -> str:
    return next((line.strip() for line in str(error).splitlines() if line.strip()), type(error).__name__)
