"""The factor graph: poses of keyframes, positions of landmarks, and the factors between them.

Errors of GTSAM become ``FactorGraphError`` with the keyframe or landmark they concern.
"""

from __future__ import annotations

import logging
import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X

from logs.messages import FactorGraphRecord
from slam.backend.estimates import Estimates, read_estimates
from slam.backend.factors import (
    MIN_RANGE_RANGES,
    PRIOR_SIGMA_RANGES,
    Edge,
    EdgeKind,
    Factor,
    LandmarkPrior,
    Observation,
    PosePrior,
    bearing_range_factors,
    between_factor,
    checked_pose,
    landmark_prior_factor,
    map_frame_factor,
    prior_factor,
)
from slam.backend.marginals import Marginals, compute_marginals, marginals_one_by_one
from slam.common.arrays import FloatArray, IntArray
from slam.common.config import DetectionConfig, FactorGraphConfig
from slam.common.errors import FactorGraphError
from slam.common.geometry import apply, invert
from slam.common.union_find import UnionFind

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


class FactorGraph:
    """Incremental estimate by iSAM2 (Kaess et al. 2012) while the drive goes on, one batch solution at its end.

    ``factors`` maps a number that never changes to each factor that is in force.
    ``solver_seconds`` is the time spent inside GTSAM. ``sensor_range_m`` is that of the detections.
    """

    def __init__(self, config: FactorGraphConfig, *, sensor_range_m: float = DetectionConfig().sensor_range_m) -> None:
        self._config = config
        self._min_range_m = MIN_RANGE_RANGES * sensor_range_m
        self._prior_sigma_m = PRIOR_SIGMA_RANGES * sensor_range_m
        self._relinearize_unit_m = RELINEARIZE_UNIT_RANGES * sensor_range_m
        self._isam = self._new_isam("CHOLESKY")
        self._values: gtsam.Values | None = None
        self._marginals: tuple[gtsam.Values, Marginals] | None = None
        self._pending: list[int] = []
        self._pending_factors = gtsam.NonlinearFactorGraph()
        self._pending_values = gtsam.Values()
        self._removed_slots: list[int] = []
        self._leaving: set[int] = set()
        self._slots: dict[int, int] = {}
        self._landmark_factors: dict[int, list[int]] = {}  # by the landmark that was seen
        self._variables: dict[int, list[int]] = {}  # landmarks in the graph by the variable that they share
        self._aliases = UnionFind()
        self._fixed_poses: dict[int, FloatArray] = {}
        self._known_positions: dict[int, tuple[FloatArray, FloatArray]] = {}  # of a prior map, with standard deviations
        self._fixed_landmarks: set[int] = set()
        self._map_frame: int | None = None  # keyframe that stands for the frame of a map without keyframes
        self._landmark_priors: dict[int, int] = {}  # priors of the landmarks of a prior map that are in the graph
        self._keyframes: list[int] = []
        self._next_factor = 0
        self.factors: dict[int, Factor] = {}
        self.solver_seconds = 0.0

    @property
    def keyframes(self) -> IntArray:
        """Ids (K,) of the keyframes, in the order in which they were added."""
        return np.array(self._keyframes, dtype=np.int64)

    @property
    def landmarks(self) -> IntArray:
        """Ids (L,) of the landmarks that are estimated, ascending; a merged one has the id of the landmark
        it was merged into; those of a fixed map are constants and left out.
        """
        return np.array(sorted(self._variables.keys() - self._fixed_landmarks), dtype=np.int64)

    def add_first_keyframe(self, keyframe: int, T_map_body: FloatArray) -> None:
        """Fix the map frame: a prior on the first keyframe."""
        self._insert_keyframe(keyframe, T_map_body)
        self._add(PosePrior(keyframe, T_map_body, self._prior_sigma_m))

    def add_next_keyframe(self, edge: Edge) -> None:
        """Add the keyframe ``edge.to_keyframe``, placed from ``edge.from_keyframe`` by the edge."""
        factor = between_factor(edge)
        self._insert_keyframe(edge.to_keyframe, self.pose(edge.from_keyframe) @ edge.T_from_to)
        self._add(edge, factor)

    def restore(
        self,
        keyframes: Sequence[int],
        T_map_body: FloatArray,
        landmarks: Mapping[int, FloatArray],
        edges: Sequence[Edge],
        observations: Sequence[Observation],
        *,
        tie: Edge | None = None,
    ) -> None:
        """Restore the optimised graph of a prior map, into an empty graph or beside what is there.

        Args:
            keyframes: ids; without a ``tie`` the first one fixes the map frame.
            T_map_body: (K, 4, 4), their estimates.
            landmarks: estimates (3,) m by id.
            edges: between those keyframes, which they tie all together.
            observations: of those landmarks from those keyframes.
            tie: leads from a keyframe that is there to one of these.
        """
        for keyframe, T in zip(keyframes, T_map_body, strict=True):
            if tie is None and keyframe == keyframes[0]:
                self.add_first_keyframe(keyframe, T)
            else:
                self._insert_keyframe(keyframe, T)
        for edge in edges if tie is None else (tie, *edges):
            self.add_edge(edge)
        for observation in observations:
            self._enter(observation.landmark, landmarks[observation.landmark])
        self.add_observations(observations)
        self.update()

    def add_fixed_map(
        self, keyframes: Sequence[int], T_map_body: FloatArray, landmarks: Mapping[int, FloatArray]
    ) -> None:
        """Add a fixed map, for localization only, to an empty graph.

        Args:
            keyframes: ids.
            T_map_body: (K, 4, 4), their poses.
            landmarks: their positions, (3,) m by id; each enters the graph when something is merged into it.
        """
        for keyframe, T in zip(keyframes, T_map_body, strict=True):
            self._insert_keyframe(keyframe, T)
            self._add(PosePrior(keyframe, T, self._prior_sigma_m))
            self._fixed_poses[keyframe] = T
        self.add_known_landmarks(landmarks, np.full(3, self._prior_sigma_m), is_fixed=True)
        self.update()

    def add_map_frame(self, keyframe: int) -> None:
        """Add the frame of a map without keyframes to an empty graph: a keyframe at its origin that stays there."""
        self.add_fixed_map([keyframe], np.eye(4)[None], {})
        self._map_frame = keyframe

    def add_known_landmarks(self, landmarks: Mapping[int, FloatArray], sigmas_m: FloatArray, *, is_fixed: bool) -> None:
        """Announce landmarks of a prior map; each enters the graph when something is merged into it.

        Args:
            landmarks: their positions, (3,) m by id.
            sigmas_m: (3,) standard deviations of the coordinates.
            is_fixed: they are constants, and not estimated.
        """
        self._known_positions.update((landmark, (position, sigmas_m)) for landmark, position in landmarks.items())
        if is_fixed:
            self._fixed_landmarks.update(landmarks)

    def add_edge(self, edge: Edge) -> int:
        """Tie two keyframes together; returns the factor's number."""
        for keyframe in (edge.from_keyframe, edge.to_keyframe):
            if not self._has_keyframe(keyframe):
                raise FactorGraphError(
                    f"edge {edge.from_keyframe} -> {edge.to_keyframe}: keyframe {keyframe} is not in the graph"
                )
        return self._add(edge)

    def add_joining_edge(self, edge: Edge, moved: IntArray) -> int:
        """Tie two stretches together that only a break of the odometry tied: the keyframes ``moved`` (K,), with one end
        of the edge, and the landmarks that only they saw are first moved as a whole to where the edge puts them.

        No solver would find there: to its robust kernel the edge would be as wrong as any.
        """
        number = self.add_edge(edge)
        self.update()
        T_from, T_to = self.pose(edge.from_keyframe), self.pose(edge.to_keyframe)
        if edge.to_keyframe in moved:
            T_shift = T_from @ edge.T_from_to @ invert(T_to)
        else:
            T_shift = T_to @ invert(edge.T_from_to) @ invert(T_from)
        with self._solver("the joining of two segments"):
            values = self._moved(set(moved.tolist()), T_shift)
            self._relax_breaks(set(moved.tolist()), values)
            numbers = list(self.factors)
            try:
                result = self._start_over(numbers, values, "CHOLESKY")
            except RuntimeError as error:
                logger.info("joining by Cholesky failed (%s); solving afresh by QR", _first_line(error))
                result = self._start_over(numbers, values, "QR")
        self._values = None
        self._slots = dict(zip(numbers, result.getNewFactorsIndices(), strict=True))
        return number

    def _relax_breaks(self, keyframes: set[int], values: gtsam.Values) -> None:
        """Let breaks of the odometry between some keyframes and the others say what the estimate ``values`` says: they
        hold no information, and would pull at a stretch that was moved far.
        """
        for number, factor in self.factors.items():
            if not isinstance(factor, Edge) or factor.kind != EdgeKind.DISCONTINUITY:
                continue
            if (factor.from_keyframe in keyframes) != (factor.to_keyframe in keyframes):
                T_from, T_to = (
                    values.atPose3(X(keyframe)).matrix() for keyframe in (factor.from_keyframe, factor.to_keyframe)
                )
                self.factors[number] = replace(factor, T_from_to=np.asarray(invert(T_from) @ T_to))

    def _moved(self, keyframes: set[int], T_shift: FloatArray) -> gtsam.Values:
        """The estimate with some keyframes, and the landmarks that no other saw, moved by ``T_shift`` (4, 4)."""
        stays = {
            self._aliases.find(factor.landmark)
            for factor in self.factors.values()
            if isinstance(factor, Observation) and factor.keyframe not in keyframes
        }
        estimate, values, shift = self._estimate(), gtsam.Values(), gtsam.Pose3(T_shift)
        for keyframe in self._keyframes:
            pose = estimate.atPose3(X(keyframe))
            values.insert(X(keyframe), shift.compose(pose) if keyframe in keyframes else pose)
        for variable in self._variables:
            point = estimate.atPoint3(L(variable))
            is_kept = variable in stays or variable in self._known_positions
            values.insert(L(variable), point if is_kept else shift.transformFrom(point))
        return values

    def add_observations(self, observations: Sequence[Observation]) -> int:
        """Tie landmarks to the keyframes that saw them; returns how many were used.

        A landmark enters the graph with its first observation, which gives it all three coordinates, so none is ever
        under-constrained. Observations nearer than ``MIN_RANGE_RANGES``, whose bearing is undefined, are passed over.
        """
        used = [each for each in observations if not np.linalg.norm(each.position) < self._min_range_m]
        poses = {keyframe: self.pose(keyframe) for keyframe in dict.fromkeys(each.keyframe for each in used)}
        factors = bearing_range_factors([self._canonical(each) for each in used], self._config)
        for observation, factor in zip(used, factors, strict=True):
            T_map_body = poses[observation.keyframe]
            if observation.landmark not in self._landmark_factors:
                self._enter(observation.landmark, apply(T_map_body, observation.position[None])[0])
            self._landmark_factors[observation.landmark].append(self._add(observation, factor))
        return len(used)

    def observers(self) -> dict[int, set[int]]:
        """The keyframes that saw each landmark which has a variable of its own, those merged into it included."""
        return {
            variable: {
                factor.keyframe
                for landmark in landmarks
                for number in self._landmark_factors[landmark]
                if isinstance(factor := self.factors[number], Observation)
            }
            for variable, landmarks in self._variables.items()
        }

    def remove_factor(self, number: int) -> None:
        """Take a factor out again; a landmark without observations leaves the graph with its last one."""
        if number not in self._slots:
            self.update()
        factor = self.factors.pop(number)
        self._removed_slots.append(self._slots.pop(number))
        if isinstance(factor, Observation):
            remaining = self._landmark_factors[factor.landmark]
            remaining.remove(number)
            if not remaining:
                self._leave(factor.landmark)

    def remove_landmark(self, landmark: int) -> None:
        """Take a landmark, with all that was merged into it, and all observations of it out of the graph.

        Nothing happens if it is not in it.
        """
        for each in (landmark, *self._aliases.absorbed(landmark)):
            for number in list(self._landmark_factors.get(each, ())):
                self.remove_factor(number)

    def merge_landmarks(self, kept: int, dropped: int) -> None:
        """Merge two landmarks: observations of ``dropped``, now or later, are observations of ``kept``.

        What they were merged into before is merged; nothing happens if they are one already.
        """
        moved = self._aliases.find(dropped)
        if moved != self._aliases.find(kept):
            self._move(moved, lambda: self._aliases.merge(kept, dropped))

    def undo_merge(self) -> None:
        """Undo the last merge in force: what was dropped is its own landmark again, with all that it had absorbed.

        Raises:
            FactorGraphError: no merge is in force.
        """
        if not self._aliases:
            raise FactorGraphError("no landmarks are merged, so no merge can be undone")
        last = self._aliases.history[-1]
        self._move(last.dropped, lambda: self._aliases.undo(last))

    def _move(self, landmark: int, rename: Callable[[], object]) -> None:
        """Take the observations of a landmark, and of those merged into it, along to its new variable."""
        moved = [landmark, *self._aliases.absorbed(landmark)]
        observations = [self.factors[number] for each in moved for number in self._landmark_factors.get(each, ())]
        self.remove_landmark(landmark)
        rename()
        self.add_observations([o for o in observations if isinstance(o, Observation)])

    def _canonical(self, observation: Observation) -> Observation:
        """The observation of the variable that its landmark has in the graph."""
        if not self._aliases.is_dropped(observation.landmark):
            return observation
        return replace(observation, landmark=self._aliases.find(observation.landmark))

    def _enter(self, landmark: int, position_map: FloatArray) -> None:
        """Give a landmark a variable, where it has none."""
        if landmark in self._landmark_factors:
            return
        variable = self._aliases.find(landmark)
        if variable not in self._variables:
            if variable in self._leaving:
                self.update()
            self._variables[variable] = []
            known, sigmas_m = self._known_positions.get(variable, (None, None))
            self._pending_values.insert(L(variable), position_map if known is None else known)
            if known is not None and sigmas_m is not None:
                self._landmark_priors[variable] = self._add(LandmarkPrior(variable, known, sigmas_m))
        self._variables[variable].append(landmark)
        self._landmark_factors[landmark] = []

    def _leave(self, landmark: int) -> None:
        del self._landmark_factors[landmark]
        variable = self._aliases.find(landmark)
        self._variables[variable].remove(landmark)
        if not self._variables[variable]:
            del self._variables[variable]
            if variable in self._landmark_priors:
                self.remove_factor(self._landmark_priors.pop(variable))
            self._leaving.add(variable)

    def update(self) -> None:
        """Bring the incremental estimate up to date with all that was added and removed."""
        if not self._pending and not self._removed_slots:
            return
        with self._solver("the incremental update"):
            try:
                result = self._isam.update(self._pending_factors, self._pending_values, self._removed_slots)
                numbers = self._pending
            except RuntimeError as error:
                logger.info("the incremental update failed (%s); solving afresh by QR", _first_line(error))
                numbers = list(self.factors)
                # The failed update has taken the new variables in already.
                result = self._start_over(numbers, self._isam.getLinearizationPoint(), "QR")
            self._values = None
        self._slots.update(zip(numbers, result.getNewFactorsIndices(), strict=True))
        self._pending = []
        self._removed_slots = []
        self._leaving.clear()
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
        if keyframe in self._fixed_poses:
            return self._fixed_poses[keyframe]
        key = X(keyframe)
        if self._pending_values.exists(key):
            return np.asarray(self._pending_values.atPose3(key).matrix())
        if not self._isam.valueExists(key):
            raise FactorGraphError(f"keyframe {keyframe} is not in the graph")
        if self._values is not None:
            return np.asarray(self._values.atPose3(key).matrix())
        with self._solver(f"the estimate of keyframe {keyframe}"):
            return np.asarray(self._isam.calculateEstimatePose3(key).matrix())

    def poses(self) -> FloatArray:
        """``T_map_body`` (K, 4, 4) of all keyframes, in the order of ``keyframes``."""
        self.update()
        values = self._estimate()
        fixed = self._fixed_poses
        return np.array([fixed.get(k, values.atPose3(X(k)).matrix()) for k in self._keyframes]).reshape(-1, 4, 4)

    def landmark_positions(self, landmarks: IntArray) -> FloatArray:
        """Positions (N, 3) m in the map of landmarks that are in the graph."""
        self.update()
        self._check_landmarks(landmarks)
        values = self._estimate()
        return np.array([values.atPoint3(L(int(i))) for i in landmarks]).reshape(-1, 3)

    def estimates(self) -> Estimates:
        """Where everything is as far as it is known now; nothing is solved for it."""
        return read_estimates(self._estimate(), self._pending_values)

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
            edge_kinds=tuple(str(e.kind) for e in edges),
            observation_keyframe_ids=np.array([o.keyframe for o in observations], dtype=np.int64),
            observation_landmark_ids=tuple(str(self._aliases.find(o.landmark)) for o in observations),
            observation_positions=np.array([o.position for o in observations]).reshape(-1, 3),
            observation_covariances=np.array([o.covariance_inflation * o.covariance for o in observations]).reshape(
                -1, 3, 3
            ),
            pose_covariances=self._pose_covariances_if_known(),
            observation_redundancies=_covariance_inflations(observations),
        )

    def _estimate(self) -> gtsam.Values:
        """All variables; iSAM2 computes those not queried before only here."""
        if self._values is None:
            with self._solver("the estimate"):
                self._values = self._isam.calculateEstimate()
        return self._values

    def landmark_covariances(self, landmarks: IntArray) -> FloatArray:
        """Marginal covariances (N, 3, 3) m^2 in the map frame, at the current estimate."""
        self.update()
        self._check_landmarks(landmarks)
        return self._all_marginals().of_landmarks(landmarks) if len(landmarks) else np.zeros((0, 3, 3))

    def pose_covariances(self) -> FloatArray:
        """Marginal covariances (K, 6, 6) of all keyframes, in the order of ``keyframes``, at the current estimate.

        Rotation [rad] before translation [m], of the right perturbation ``T_map_body Exp(xi)``: about the body's axes.
        """
        self.update()
        return self._all_marginals().of_keyframes(self.keyframes) if self._keyframes else np.zeros((0, 6, 6))

    def _pose_covariances_if_known(self) -> FloatArray:
        try:
            return self.pose_covariances()
        except FactorGraphError as error:
            logger.warning("the graph is logged without covariances of its poses: %s", error)
            return np.zeros((0, 6, 6))

    def _all_marginals(self) -> Marginals:
        """The covariances at the current estimate, computed once."""
        values = self._estimate()
        if self._marginals is None or self._marginals[0] is not values:
            with self._solver("the marginal covariances"):
                self._marginals = values, self._compute_marginals(values)
        return self._marginals[1]

    def _compute_marginals(self, values: gtsam.Values) -> Marginals:
        try:
            records = [self.factors[number] for number in sorted(self._slots, key=self._slots.__getitem__)]
            return compute_marginals(self._isam.getFactorsUnsafe(), values, records, self._config)
        except np.linalg.LinAlgError as error:
            logger.info("the marginals come one by one from the incremental solver: %s", error)
            return marginals_one_by_one(self._isam, values)

    def _new_isam(self, factorization: str) -> gtsam.ISAM2:
        parameters = gtsam.ISAM2Params()
        parameters.setRelinearizeThreshold(self._relinearize_thresholds())
        parameters.relinearizeSkip = self._config.relinearize_skip
        parameters.setFactorization(factorization)
        return gtsam.ISAM2(parameters)

    def _relinearize_thresholds(self) -> gtsam.ISAM2ThresholdMap:
        """``relinearize_threshold`` in radians and in units of length that are a fraction of the sensor range."""
        rotation = self._config.relinearize_threshold
        translation = rotation * self._relinearize_unit_m
        thresholds = gtsam.ISAM2ThresholdMap()
        thresholds.insert(("x", np.repeat([rotation, translation], 3)))
        thresholds.insert(("l", np.repeat(translation, 3)))
        return thresholds

    def _start_over(self, numbers: list[int], values: gtsam.Values, factorization: str) -> gtsam.ISAM2Result:
        """Put all factors into a fresh iSAM2.

        One that eliminates by QR is slower than Cholesky, but it bears the poor conditioning of, say, a very sure
        odometry beside landmarks that the robust kernel has all but switched off.
        """
        kept = gtsam.Values()
        for keyframe in self._keyframes:
            kept.insert(X(keyframe), values.atPose3(X(keyframe)))
        for variable in self._variables:
            kept.insert(L(variable), values.atPoint3(L(variable)))
        graph = gtsam.NonlinearFactorGraph()
        records = [self.factors[number] for number in numbers]
        observations = [self._canonical(record) for record in records if isinstance(record, Observation)]
        of_observations = iter(bearing_range_factors(observations, self._config))
        for record in records:
            graph.add(next(of_observations) if isinstance(record, Observation) else self._factor(record))
        self._isam = self._new_isam(factorization)
        return self._isam.update(graph, kept)

    def _check_landmarks(self, landmarks: IntArray) -> None:
        for landmark in landmarks.tolist():
            if landmark not in self._variables:
                raise FactorGraphError(f"landmark {landmark} is not in the graph")

    def _has_keyframe(self, keyframe: int) -> bool:
        return self._pending_values.exists(X(keyframe)) or self._isam.valueExists(X(keyframe))

    def _insert_keyframe(self, keyframe: int, T_map_body: FloatArray) -> None:
        pose = checked_pose(T_map_body, f"keyframe {keyframe}")
        if self._has_keyframe(keyframe):
            raise FactorGraphError(f"keyframe {keyframe} is in the graph already")
        self._pending_values.insert(X(keyframe), pose)
        self._keyframes.append(keyframe)

    def _add(self, record: Factor, factor: gtsam.NonlinearFactor | None = None) -> int:
        number = self._next_factor
        self._pending_factors.add(factor if factor is not None else self._factor(record))
        self._next_factor += 1
        self.factors[number] = record
        self._pending.append(number)
        return number

    def _factor(self, record: Factor) -> gtsam.NonlinearFactor:
        match record:
            case Edge():
                return map_frame_factor(record) if record.from_keyframe == self._map_frame else between_factor(record)
            case Observation():
                return bearing_range_factors([self._canonical(record)], self._config)[0]
            case PosePrior():
                return prior_factor(record)
            case LandmarkPrior():
                return landmark_prior_factor(record)

    @contextmanager
    def _solver(self, doing: str) -> Iterator[None]:
        """Measure the time inside GTSAM, and convert its exceptions to ``FactorGraphError``."""
        started = time.perf_counter()
        try:
            yield
        except (RuntimeError, ValueError, IndexError) as error:
            raise FactorGraphError(f"{doing} failed{_variable_in(str(error))}: {_first_line(error)}") from error
        finally:
            self.solver_seconds += time.perf_counter() - started


def _covariance_inflations(observations: Sequence[Observation]) -> FloatArray:
    """Those of observations (O,), none where all are 1."""
    inflations = np.array([observation.covariance_inflation for observation in observations], dtype=np.float64)
    return inflations if (inflations != 1.0).any() else np.zeros(0)


def _variable_in(message: str) -> str:
    """The keyframe or landmark that a GTSAM message names as a symbol, e.g. x12 or l7."""
    found = re.search(r"\b([xl])(\d+)\b", message)
    if found is None:
        return ""
    return f" at {'keyframe' if found[1] == 'x' else 'landmark'} {found[2]}"


def _first_line(error: Exception) -> str:
    return next((line.strip() for line in str(error).splitlines() if line.strip()), type(error).__name__)
