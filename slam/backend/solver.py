"""The solver: iSAM2 during the drive, Levenberg-Marquardt over everything at its end."""

import logging
import re
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager

import gtsam
import numpy as np

from logs.records import frozen
from slam.common.arrays import FloatArray
from slam.common.errors import FactorGraphError

logger = logging.getLogger(__name__)

RELINEARIZE_RAD = 0.05
"""Rotation that relinearises a pose."""


@frozen
class Optimization:
    """How the batch optimisation ended; ``error``: the cost at its end, in nats."""

    converged: bool
    iterations: int
    error: float


class Solver:
    """Factors of GTSAM by the caller's numbers, not negative, and the values of the variables that they tie together.

    Updates are those of iSAM2 (Kaess et al. 2012); after a batch optimisation the next one begins again from its
    result. Variables are named by GTSAM's keys. A landmark leaves with its last factor.
    """

    def __init__(self, *, sensor_range_m: float) -> None:
        self._relinearize_m = RELINEARIZE_RAD * (1.0 / 30.0 * sensor_range_m)
        self._isam: gtsam.ISAM2 | None = None
        self._slots: dict[int, int] = {}  # places of the factors in iSAM2
        self._values: gtsam.Values | None = None  # of its estimate, unless not asked for yet
        self.factors: dict[int, gtsam.NonlinearFactor] = {}
        """All of them, by their numbers."""
        self.restart({}, gtsam.Values())

    def restart(self, changed: Mapping[int, gtsam.NonlinearFactor], values: gtsam.Values) -> None:
        """Put some factors in the place of those of their numbers; the next update solves all from ``values``."""
        factors, self.factors = {**self.factors, **changed}, {}
        self._uses: Counter[int] = Counter()
        self._begin(None, values)
        for number, factor in factors.items():
            self.add(number, factor)

    def insert(self, key: int, value: gtsam.Pose3 | FloatArray, prior: gtsam.NonlinearFactor | None = None) -> None:
        """Add a variable, the pose of a keyframe or the position (3,) m of a landmark, with its initial value, unless
        there is a factor on it already; one that left since the last update stays where it was.

        ``prior``: a factor on it; that of a landmark leaves with it.
        """
        if self._uses[key]:
            return
        if prior is not None:
            self.add(-key, prior)
        if not (self.values().exists(key) if self._isam is None else self._isam.valueExists(key)):
            self._new_values.insert(key, value)

    def add(self, number: int, factor: gtsam.NonlinearFactor) -> None:
        """Add a factor between variables that are held."""
        self.factors[number] = self._added[number] = factor
        self._uses.update(factor.keys())

    def remove(self, number: int) -> None:
        """Remove a factor; a landmark leaves with its last one."""
        factor = self.factors.pop(number)
        if self._added.pop(number, None) is None:
            self._removed.append(number)
        for key in factor.keys():  # noqa: SIM118 - a GTSAM factor is not a mapping
            self._uses[key] -= 1
            if gtsam.symbolChr(key) != ord("l"):
                continue
            if self._uses[key] == 1 and -key in self.factors:
                self.remove(-key)
            elif not self._uses[key] and self._new_values.exists(key):
                self._new_values.erase(key)

    def pose(self, key: int) -> FloatArray:
        """Estimate (4, 4) of a pose."""
        with gtsam_errors("the estimate of a pose"):
            if self._new_values.exists(key):
                return self._new_values.atPose3(key).matrix()
            if self._isam is None or self._values is not None:
                return self.values().atPose3(key).matrix()
            return self._isam.calculateEstimatePose3(key).matrix()

    def values(self) -> gtsam.Values:
        """The estimate of all variables as of the last update; iSAM2 computes those that were not queried only here."""
        if self._values is None:
            assert self._isam is not None
            with gtsam_errors("the estimate"):
                self._values = self._isam.calculateEstimate()
        return self._values

    def values_with_new(self) -> gtsam.Values:
        """The same with the initial values of the variables that were added since."""
        values = gtsam.Values(self.values())
        values.insert(self._new_values)
        return values

    def update(self) -> None:
        """Bring the estimate up to date with all that was added and removed."""
        if not self._added and not self._removed:
            return
        isam = self._isam
        with gtsam_errors("the incremental update"):
            try:
                if isam is None:
                    self._solve_afresh(self.values_with_new(), "CHOLESKY")
                else:
                    removed = [self._slots.pop(number) for number in self._removed]
                    result = isam.update(graph_of(self._added.values()), self._new_values, removed)
                    self._slots.update(zip(self._added, result.getNewFactorsIndices(), strict=True))
                    self._begin(isam, None)
            except RuntimeError as error:
                logger.info("the incremental update failed (%s); solving again with QR", _first_line(error))
                # A failed update of iSAM2 has the new variables already.
                values = self.values_with_new() if isam is None else isam.getLinearizationPoint()
                self._solve_afresh(values, "QR")

    def optimize(self, min_decrease: float) -> Optimization:
        """Solve to the end, which a step is that lowers the cost by less than ``min_decrease`` nats."""
        if self._isam is not None:
            self.update()
        graph = self._graph()
        with gtsam_errors("the batch optimisation"):
            values, found = _optimum(graph, _values_of(graph, self.values_with_new()), min_decrease)
            self._begin(None, values)
        return found

    def outliers(self, numbers: Iterable[int], values: gtsam.Values | None = None) -> set[int]:
        """Those of the factors of these numbers that the current estimate, or ``values``, all but leave out."""
        return {each for each in numbers if is_outlier(self.factors[each], values or self.values())}

    def optimize_anew(self, min_decrease: float, numbers: Collection[int]) -> None:
        """Solve again from where the factors of these numbers count in full, if then fewer of them are outliers than at
        the current estimate.
        """
        graph = self._graph()
        plain = graph_of(
            without_kernel(each) if number in numbers else each for number, each in sorted(self.factors.items())
        )
        with gtsam_errors("the batch optimisation"):
            values, _ = _optimum(plain, _values_of(graph, self.values()), min_decrease)
            values, _ = _optimum(graph, values, min_decrease)
        if len(self.outliers(numbers, values)) < len(self.outliers(numbers)):
            self._begin(None, values)

    def log_determinant(self) -> float:
        """Of the information of all variables together."""
        with gtsam_errors("the elimination of all variables"):
            linear = self._graph().linearize(self.values())
            return 2.0 * linear.eliminateMultifrontal().logDeterminant()

    def _graph(self) -> gtsam.NonlinearFactorGraph:
        return graph_of(self.factors[number] for number in sorted(self.factors))

    def _begin(self, isam: gtsam.ISAM2 | None, values: gtsam.Values | None) -> None:
        """Begin with an estimate of all variables: ``values``, or those of iSAM2."""
        self._isam, self._values = isam, values
        self._new_values = gtsam.Values()
        self._added: dict[int, gtsam.NonlinearFactor] = {}  # since the last update
        self._removed: list[int] = []  # of those that were there at the last update

    def _solve_afresh(self, values: gtsam.Values, factorization: str) -> None:
        """Put all factors into a new iSAM2.

        Elimination by QR is slower than by Cholesky, but bears the poor conditioning of, say, a very exact odometry
        beside landmarks that the robust kernel has all but switched off.
        """
        thresholds = gtsam.ISAM2ThresholdMap()  # by the sensor range
        for poses in "xe":
            thresholds.insert((poses, np.repeat([RELINEARIZE_RAD, self._relinearize_m], 3)))
        thresholds.insert(("l", np.repeat(self._relinearize_m, 3)))
        parameters = gtsam.ISAM2Params()
        parameters.setRelinearizeThreshold(thresholds)
        parameters.setFactorization(factorization)
        isam, graph = gtsam.ISAM2(parameters), self._graph()
        result = isam.update(graph, _values_of(graph, values))
        self._slots = dict(zip(sorted(self.factors), result.getNewFactorsIndices(), strict=True))
        self._begin(isam, None)


def without_kernel(factor: gtsam.NonlinearFactor) -> gtsam.NonlinearFactor:
    """A factor that counts in full, however large its error is."""
    if isinstance(factor, gtsam.NoiseModelFactor) and isinstance(noise := factor.noiseModel(), gtsam.noiseModel.Robust):
        return factor.cloneWithNewNoiseModel(noise.noise())
    return factor


def is_outlier(factor: gtsam.NonlinearFactor, values: gtsam.Values) -> bool:
    """Whether its kernel gives a factor less than a tenth of its weight, as one in 1000 observations without faults."""
    if isinstance(factor, gtsam.NoiseModelFactor) and isinstance(noise := factor.noiseModel(), gtsam.noiseModel.Robust):
        return bool(noise.weight(factor.cloneWithNewNoiseModel(noise.noise()).whitenedError(values)) < 0.1)
    return False


def _optimum(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, min_decrease: float
) -> tuple[gtsam.Values, Optimization]:
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(50)
    parameters.setAbsoluteErrorTol(min_decrease)
    optimizer = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters)
    values, iterations = optimizer.optimize(), optimizer.iterations()
    return values, Optimization(iterations < parameters.getMaxIterations(), iterations, optimizer.error())


def _values_of(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> gtsam.Values:
    """The values of the variables of a graph alone."""
    kept = gtsam.Values()
    for key in graph.keyVector():
        is_point = gtsam.symbolChr(key) == ord("l")
        kept.insert(key, values.atPoint3(key) if is_point else values.atPose3(key))
    return kept


@contextmanager
def gtsam_errors(what: str) -> Iterator[None]:
    """Exceptions of GTSAM become a ``FactorGraphError``: ``what`` failed, with the keyframe or landmark it concerns."""
    try:
        yield
    except (RuntimeError, ValueError, IndexError) as error:
        # GTSAM names variables by symbols, as x12 or l7.
        found = re.search(r"\b([xl])(\d+)\b", str(error))
        where = f" at {'keyframe' if found[1] == 'x' else 'landmark'} {found[2]}" if found else ""
        raise FactorGraphError(f"{what} failed{where}: {_first_line(error)}") from error


def _first_line(error: Exception) -> str:
    """The first line of the message of an exception."""
    return str(error).strip().partition("\n")[0].strip() or type(error).__name__


def graph_of(factors: Iterable[gtsam.NonlinearFactor]) -> gtsam.NonlinearFactorGraph:
    """A graph of factors, in their order."""
    graph = gtsam.NonlinearFactorGraph()
    for factor in factors:
        graph.add(factor)
    return graph
