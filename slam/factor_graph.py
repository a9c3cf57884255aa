"""The factor graph: poses of keyframes, points of landmarks, and what ties them together. The only importer of gtsam.

Everything that enters is checked here, since GTSAM takes a rotation that is none without a word, and what it throws is
translated into which keyframe or landmark it is about. Noise in GTSAM's order: rotation, then translation.
"""

from __future__ import annotations

import re
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, partial

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X

from logs.messages import FactorGraphRecord
from slam.config import FactorGraphConfig
from slam.errors import FactorGraphError
from slam.geometry import FloatArray, IntArray, apply

PRIOR_SIGMA = 1e-4
# Nearer than this a bearing says nothing: the object is on top of the sensor.
MIN_RANGE_M = 0.3
ORTHONORMAL_TOLERANCE = 1e-6
MAX_BATCH_ITERATIONS = 50


@dataclass(frozen=True, slots=True, eq=False)
class Edge:
    """A between-factor: ``T_from_to`` (4, 4) with its covariance (6, 6); ``kind`` is "odometry" or "closure"."""

    from_keyframe: int
    to_keyframe: int
    T_from_to: FloatArray
    covariance: FloatArray
    kind: str


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """A landmark seen from a keyframe: ``position`` (3,) m in the keyframe's body frame, covariance (3, 3) m^2.

    ``redundancy``: how many such observations carry the information of one, because they share their errors.
    """

    keyframe: int
    landmark: int
    position: FloatArray
    covariance: FloatArray
    redundancy: float = 1.0


@dataclass(frozen=True, slots=True)
class Optimization:
    """How the batch optimisation ended."""

    converged: bool
    iterations: int
    error_before: float
    error_after: float


class FactorGraph:
    """Incremental estimate by iSAM2 (Kaess et al. 2012) while the drive goes on, one batch solution at its end.

    ``factors`` maps a number that never changes to each Edge and Observation that is in force.
    ``solver_seconds`` is the time spent inside GTSAM.
    """

    def __init__(self, config: FactorGraphConfig) -> None:
        self._config = config
        parameters = gtsam.ISAM2Params()
        parameters.setRelinearizeThreshold(config.relinearize_threshold)
        parameters.relinearizeSkip = config.relinearize_skip
        self._isam = gtsam.ISAM2(parameters)
        self._values: gtsam.Values | None = None
        self._kernel = cache(partial(_robust_kernel, config))
        self._pending: list[int] = []
        self._pending_factors = gtsam.NonlinearFactorGraph()
        self._pending_values = gtsam.Values()
        self._removed_slots: list[int] = []
        self._slots: dict[int, int] = {}
        self._landmark_factors: dict[int, list[int]] = {}
        self._keyframes: list[int] = []
        self._next_factor = 0
        self.factors: dict[int, Edge | Observation] = {}
        self.solver_seconds = 0.0

    @property
    def keyframes(self) -> IntArray:
        """Ids (K,) of the keyframes, in the order in which they were added."""
        return np.array(self._keyframes, dtype=np.int64)

    @property
    def landmarks(self) -> IntArray:
        """Ids (L,) of the landmarks that have an observation, ascending."""
        return np.array(sorted(key for key, factors in self._landmark_factors.items() if factors), dtype=np.int64)

    def add_first_keyframe(self, keyframe: int, T_map_body: FloatArray) -> None:
        """Fix the map frame: a prior on the first keyframe."""
        pose = _checked_pose(T_map_body, f"keyframe {keyframe}")
        self._insert_keyframe(keyframe, pose)
        noise = gtsam.noiseModel.Isotropic.Sigma(6, PRIOR_SIGMA)
        self._pending_factors.add(gtsam.PriorFactorPose3(X(keyframe), pose, noise))
        self._pending.append(-1)

    def add_next_keyframe(self, edge: Edge) -> None:
        """Add the keyframe ``edge.to_keyframe``, placed from ``edge.from_keyframe`` by the edge."""
        T_map_to = self.pose(edge.from_keyframe) @ edge.T_from_to
        self._insert_keyframe(edge.to_keyframe, _checked_pose(T_map_to, f"keyframe {edge.to_keyframe}"))
        self.add_edge(edge)

    def add_edge(self, edge: Edge) -> int:
        """Tie two keyframes together; returns the factor's number."""
        what = f"edge {edge.from_keyframe} -> {edge.to_keyframe}"
        pose = _checked_pose(edge.T_from_to, what)
        noise: gtsam.noiseModel.Base = gtsam.noiseModel.Gaussian.Covariance(
            _checked_covariance(edge.covariance, 6, what)
        )
        if edge.kind == "closure":
            noise = gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Cauchy.Create(1.0), noise)
        return self._add(edge, gtsam.BetweenFactorPose3(X(edge.from_keyframe), X(edge.to_keyframe), pose, noise))

    def add_observations(self, observations: Sequence[Observation]) -> int:
        """Tie landmarks to the keyframes that saw them; returns how many were used.

        A landmark enters the graph with its first observation, which gives it all three coordinates, so none is ever
        under-constrained. Observations nearer than ``MIN_RANGE_M``, whose bearing is undefined, are passed over.
        """
        used = 0
        for observation in observations:
            range_m = float(np.linalg.norm(observation.position))
            if range_m < MIN_RANGE_M:
                continue
            landmark = observation.landmark
            if landmark not in self._landmark_factors:
                position = apply(self.pose(observation.keyframe), observation.position[None])[0]
                self._pending_values.insert(L(landmark), position)
                self._landmark_factors[landmark] = []
            factor = self._bearing_range_factor(observation, range_m)
            self._landmark_factors[landmark].append(self._add(observation, factor))
            used += 1
        return used

    def remove_factor(self, number: int) -> None:
        """Take a factor out again; a landmark without observations leaves the graph with its last one."""
        factor = self.factors.pop(number)
        if number not in self._slots:
            self.update()
        self._removed_slots.append(self._slots.pop(number))
        if isinstance(factor, Observation):
            remaining = self._landmark_factors[factor.landmark]
            remaining.remove(number)
            if not remaining:
                del self._landmark_factors[factor.landmark]

    def remove_landmark(self, landmark: int) -> None:
        """Take a landmark and all its observations out of the graph; nothing happens if it is not in it."""
        for number in list(self._landmark_factors.get(landmark, ())):
            self.remove_factor(number)

    def merge_landmarks(self, kept: int, dropped: int) -> None:
        """Make two landmarks one: what saw ``dropped`` has seen ``kept``."""
        numbers = list(self._landmark_factors.get(dropped, ()))
        moved = [self.factors[number] for number in numbers]
        self.remove_landmark(dropped)
        self.add_observations(
            [Observation(o.keyframe, kept, o.position, o.covariance) for o in moved if isinstance(o, Observation)]
        )

    def update(self) -> None:
        """Bring the incremental estimate up to date with all that was added and removed."""
        if not self._pending and not self._removed_slots:
            return
        with self._solver("the incremental update"):
            result = self._isam.update(self._pending_factors, self._pending_values, self._removed_slots)
            self._values = None
        for number, slot in zip(self._pending, result.getNewFactorsIndices(), strict=True):
            if number >= 0:
                self._slots[number] = slot
        self._pending.clear()
        self._removed_slots.clear()
        self._pending_factors = gtsam.NonlinearFactorGraph()
        self._pending_values = gtsam.Values()

    def optimize(self) -> Optimization:
        """Solve the whole graph at once, from the incremental estimate, by Levenberg-Marquardt."""
        self.update()
        with self._solver("the batch optimisation"):
            graph = self._isam.getFactorsUnsafe().clone()
            parameters = gtsam.LevenbergMarquardtParams()
            parameters.setMaxIterations(MAX_BATCH_ITERATIONS)
            optimizer = gtsam.LevenbergMarquardtOptimizer(graph, self._estimate(), parameters)
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
        if self._values is not None:
            return np.asarray(self._values.atPose3(key).matrix())
        with self._solver(f"the estimate of keyframe {keyframe}"):
            return np.asarray(self._isam.calculateEstimatePose3(key).matrix())

    def poses(self) -> FloatArray:
        """``T_map_body`` (K, 4, 4) of all keyframes, in the order of ``keyframes``, after an update."""
        values = self._estimate()
        return np.array([values.atPose3(X(keyframe)).matrix() for keyframe in self._keyframes]).reshape(-1, 4, 4)

    def landmark_positions(self, landmarks: IntArray) -> FloatArray:
        """Positions (N, 3) m in the map of landmarks that are in the graph, after an update."""
        values = self._estimate()
        return np.array([values.atPoint3(L(int(i))) for i in landmarks]).reshape(-1, 3)

    def to_record(self, stamp_ns: int, keyframe_stamps_ns: IntArray) -> FactorGraphRecord:
        """The whole graph at its current estimate, as it goes into a log."""
        edges = [factor for factor in self.factors.values() if isinstance(factor, Edge)]
        observations = [factor for factor in self.factors.values() if isinstance(factor, Observation)]
        return FactorGraphRecord(
            stamp_ns=stamp_ns,
            keyframe_ids=self.keyframes,
            keyframe_stamps_ns=keyframe_stamps_ns,
            T_map_body=self.poses(),
            edge_keyframe_ids=np.array([(e.from_keyframe, e.to_keyframe) for e in edges], dtype=np.int64).reshape(
                -1, 2
            ),
            edge_transforms=np.array([e.T_from_to for e in edges]).reshape(-1, 4, 4),
            edge_covariances=np.array([e.covariance for e in edges]).reshape(-1, 6, 6),
            edge_kinds=tuple(e.kind for e in edges),
            observation_keyframe_ids=np.array([o.keyframe for o in observations], dtype=np.int64),
            observation_landmark_ids=tuple(str(o.landmark) for o in observations),
            observation_positions=np.array([o.position for o in observations]).reshape(-1, 3),
            observation_covariances=np.array([o.redundancy * o.covariance for o in observations]).reshape(-1, 3, 3),
        )

    def _estimate(self) -> gtsam.Values:
        """All variables; iSAM2 computes the ones that nobody asks for only here."""
        if self._values is None:
            with self._solver("the estimate"):
                self._values = self._isam.calculateEstimate()
        return self._values

    def landmark_covariances(self, landmarks: IntArray) -> FloatArray:
        """Marginal covariances (N, 3, 3) m^2 in the map frame, at the current estimate."""
        with self._solver("the marginal covariances"):
            marginals = gtsam.Marginals(self._isam.getFactorsUnsafe(), self._estimate())
            covariances = [marginals.marginalCovariance(L(int(i))) for i in landmarks]
        return np.array(covariances).reshape(-1, 3, 3)

    def _insert_keyframe(self, keyframe: int, pose: gtsam.Pose3) -> None:
        self._pending_values.insert(X(keyframe), pose)
        self._keyframes.append(keyframe)

    def _add(self, record: Edge | Observation, factor: gtsam.NonlinearFactor) -> int:
        number = self._next_factor
        self._next_factor += 1
        self.factors[number] = record
        self._pending_factors.add(factor)
        self._pending.append(number)
        return number

    def _bearing_range_factor(self, observation: Observation, range_m: float) -> gtsam.NonlinearFactor:
        what = f"observation of landmark {observation.landmark} from keyframe {observation.keyframe}"
        covariance = _checked_covariance(observation.covariance, 3, what)
        bearing = gtsam.Unit3(observation.position)
        # Error of bearing and range to first order: the tangent plane over the range, and the line of sight.
        J = np.vstack([bearing.basis().T / range_m, observation.position / range_m])
        noise: gtsam.noiseModel.Base = gtsam.noiseModel.Gaussian.Covariance(
            observation.redundancy * (J @ covariance @ J.T)
        )
        kernel = self._kernel(observation.redundancy)
        if kernel is not None:
            noise = gtsam.noiseModel.Robust.Create(kernel, noise)
        return gtsam.BearingRangeFactor3D(X(observation.keyframe), L(observation.landmark), bearing, range_m, noise)

    @contextmanager
    def _solver(self, doing: str) -> Iterator[None]:
        """Time what happens in GTSAM and say in our words what it throws."""
        started = time.perf_counter()
        try:
            yield
        except (RuntimeError, ValueError, IndexError) as error:
            raise FactorGraphError(f"{doing} failed{_variable_in(str(error))}: {_first_line(error)}") from error
        finally:
            self.solver_seconds += time.perf_counter() - started


def _robust_kernel(config: FactorGraphConfig, redundancy: float) -> gtsam.noiseModel.mEstimator.Base | None:
    """The kernel of observations: its width is meant in sigmas of one observation, before redundancy widens them."""
    width = config.observation_kernel_width / np.sqrt(redundancy)
    match config.observation_kernel:
        case "cauchy":
            return gtsam.noiseModel.mEstimator.Cauchy.Create(width)
        case "huber":
            return gtsam.noiseModel.mEstimator.Huber.Create(width)
        case _:
            return None


def _checked_pose(T: FloatArray, what: str) -> gtsam.Pose3:
    R = T[:3, :3]
    if not np.all(np.isfinite(T)) or np.abs(R @ R.T - np.eye(3)).max() > ORTHONORMAL_TOLERANCE or np.linalg.det(R) < 0:
        raise FactorGraphError(f"{what}: not a rigid transform: {np.array2string(T, precision=4)}")
    return gtsam.Pose3(T)


def _checked_covariance(covariance: FloatArray, size: int, what: str) -> FloatArray:
    if covariance.shape != (size, size) or not np.all(np.isfinite(covariance)):
        raise FactorGraphError(f"{what}: the covariance must be a finite {size} x {size} matrix")
    if np.linalg.eigvalsh(covariance)[0] <= 0.0:
        raise FactorGraphError(f"{what}: the covariance is not positive definite")
    return covariance


def _variable_in(message: str) -> str:
    """The keyframe or landmark that a GTSAM message names as a symbol, e.g. x12 or l7."""
    found = re.search(r"\b([xl])(\d+)\b", message)
    if found is None:
        return ""
    return f" at {'keyframe' if found[1] == 'x' else 'landmark'} {found[2]}"


def _first_line(error: Exception) -> str:
    return next((line.strip() for line in str(error).splitlines() if line.strip()), type(error).__name__)
