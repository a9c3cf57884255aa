"""The factor graph: poses of keyframes, positions of landmarks, and the factors between them."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X

from logs.messages import FactorGraphRecord
from slam.backend.batch_solver import BatchSolver, GtsamCalls, Optimization
from slam.backend.covariance.marginals import Marginals, compute_marginals, marginals_one_by_one
from slam.backend.estimates import Estimates
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
from slam.backend.incremental_solver import IncrementalSolver
from slam.backend.observed_landmarks import ObservedLandmarks
from slam.common.arrays import FloatArray, IntArray
from slam.common.config import DetectionConfig, FactorGraphConfig
from slam.common.errors import FactorGraphError
from slam.common.geometry import invert

logger = logging.getLogger(__name__)


class FactorGraph:
    """Incremental estimate while the drive goes on, one batch solution at its end.

    ``factors`` maps a number that never changes to each factor that is in force. ``sensor_range_m`` is that of the
    detections.
    """

    def __init__(self, config: FactorGraphConfig, *, sensor_range_m: float = DetectionConfig().sensor_range_m) -> None:
        self._config = config
        self._min_range_m = MIN_RANGE_RANGES * sensor_range_m
        self._prior_sigma_m = PRIOR_SIGMA_RANGES * sensor_range_m
        self._calls = GtsamCalls()
        self._solver: IncrementalSolver | BatchSolver = IncrementalSolver(
            config, self._calls, sensor_range_m=sensor_range_m
        )
        self._landmarks = ObservedLandmarks()
        self._marginals: tuple[gtsam.Values, Marginals] | None = None
        self._fixed_poses: dict[int, FloatArray] = {}
        self._known_positions: dict[int, tuple[FloatArray, FloatArray]] = {}  # of a prior map, with standard deviations
        self._fixed_landmarks: set[int] = set()
        self._map_frame: int | None = None  # keyframe that stands for the frame of a map without keyframes
        self._landmark_priors: dict[int, int] = {}  # priors of the landmarks of a prior map that are in the graph
        self._keyframes: list[int] = []
        self._next_factor = 0
        self.factors: dict[int, Factor] = {}

    @property
    def solver_seconds(self) -> float:
        """Time spent inside GTSAM."""
        return self._calls.seconds

    @property
    def keyframes(self) -> IntArray:
        """Ids (K,) of the keyframes, in the order in which they were added."""
        return np.array(self._keyframes, dtype=np.int64)

    @property
    def landmarks(self) -> IntArray:
        """Ids (L,) of the landmarks that are estimated, ascending; a merged one has the id of the landmark
        it was merged into; those of a fixed map are constants and left out.
        """
        return np.array(sorted(self._landmarks.variables - self._fixed_landmarks), dtype=np.int64)

    def add_first_keyframe(self, keyframe: int, T_map_body: FloatArray) -> None:
        """Fix the map frame: a prior on the first keyframe."""
        self._insert_keyframe(keyframe, T_map_body)
        self._add(PosePrior(keyframe, T_map_body, self._prior_sigma_m))

    def add_next_keyframe(self, edge: Edge, T_from_to: FloatArray | None = None) -> None:
        """Add the keyframe ``edge.to_keyframe``, placed from ``edge.from_keyframe`` by the edge.

        ``T_from_to`` (4, 4) is a better estimate to place it by, where there is one, until the next update.
        """
        factor = between_factor(edge)
        placed_by = edge.T_from_to if T_from_to is None else T_from_to
        self._insert_keyframe(edge.to_keyframe, self.pose(edge.from_keyframe) @ placed_by)
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
            if not self._solver.holds_keyframe(keyframe):
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
        with self._calls.doing("the joining of two segments"):
            values = self._moved(set(moved.tolist()), T_shift)
            self._solver.restart(values, self._relax_breaks(set(moved.tolist()), values))
        return number

    def _relax_breaks(self, keyframes: set[int], values: gtsam.Values) -> dict[int, gtsam.NonlinearFactor]:
        """Let breaks of the odometry between some keyframes and the others say what the estimate ``values`` says: they
        hold no information, and would pull at a stretch that was moved far. Returns the factors that changed.
        """
        changed = dict[int, gtsam.NonlinearFactor]()
        for number, factor in self.factors.items():
            if not isinstance(factor, Edge) or factor.kind != EdgeKind.DISCONTINUITY:
                continue
            if (factor.from_keyframe in keyframes) != (factor.to_keyframe in keyframes):
                T_from, T_to = (
                    values.atPose3(X(keyframe)).matrix() for keyframe in (factor.from_keyframe, factor.to_keyframe)
                )
                relaxed = replace(factor, T_from_to=np.asarray(invert(T_from) @ T_to))
                self.factors[number], changed[number] = relaxed, self._factor(relaxed)
        return changed

    def _moved(self, keyframes: set[int], T_shift: FloatArray) -> gtsam.Values:
        """The estimate with some keyframes, and the landmarks that no other saw, moved by ``T_shift`` (4, 4)."""
        stays = {
            self._landmarks.variable_of(factor.landmark)
            for factor in self.factors.values()
            if isinstance(factor, Observation) and factor.keyframe not in keyframes
        }
        estimate, values, shift = self._solver.estimate(), gtsam.Values(), gtsam.Pose3(T_shift)
        for keyframe in self._keyframes:
            pose = estimate.atPose3(X(keyframe))
            values.insert(X(keyframe), shift.compose(pose) if keyframe in keyframes else pose)
        for variable in self._landmarks.variables:
            if not self._solver.holds_landmark(variable):
                continue
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
        factors = bearing_range_factors([self._canonical(each) for each in used], self._config)
        for observation, factor, position in zip(used, factors, self._positions_map(used), strict=True):
            if observation.landmark not in self._landmarks:
                self._enter(observation.landmark)
            number = self._number(observation)
            variable = self._landmarks.variable_of(observation.landmark)
            self._solver.add_observation(number, factor, observation.keyframe, variable, position)
            self._landmarks.observe(observation.landmark, number)
        return len(used)

    def _positions_map(self, observations: Sequence[Observation]) -> FloatArray:
        """Where observations (N,) put their landmarks, (N, 3) m in the map."""
        poses = {keyframe: self.pose(keyframe) for keyframe in dict.fromkeys(each.keyframe for each in observations)}
        T = np.array([poses[each.keyframe] for each in observations]).reshape(-1, 4, 4)
        positions = np.array([each.position for each in observations]).reshape(-1, 3, 1)
        return np.asarray((T[:, :3, :3] @ positions)[..., 0] + T[:, :3, 3])

    def observers(self) -> dict[int, set[int]]:
        """The keyframes that saw each landmark which has a variable of its own, those merged into it included."""
        return {
            variable: {factor.keyframe for number in numbers if isinstance(factor := self.factors[number], Observation)}
            for variable, numbers in self._landmarks.factors_of_variables()
        }

    def remove_factor(self, number: int) -> None:
        """Take a factor out again; a landmark without observations leaves the graph with its last one."""
        factor = self.factors.pop(number)
        self._solver.remove(number)
        if isinstance(factor, Observation):
            unseen = self._landmarks.forget(factor.landmark, number)
            if unseen in self._landmark_priors:
                self.remove_factor(self._landmark_priors.pop(unseen))

    def remove_landmark(self, landmark: int) -> None:
        """Take a landmark, with all that was merged into it, and all observations of it out of the graph.

        Nothing happens if it is not in it.
        """
        for number in self._landmarks.factors_of(landmark):
            self.remove_factor(number)

    def merge_landmarks(self, kept: int, dropped: int) -> None:
        """Merge two landmarks: observations of ``dropped``, now or later, are observations of ``kept``.

        What they were merged into before is merged; nothing happens if they are one already.
        """
        if not self._landmarks.are_one(kept, dropped):
            self._move(self._landmarks.variable_of(dropped), lambda: self._landmarks.merge(kept, dropped))

    def undo_merge(self) -> None:
        """Undo the last merge in force: what was dropped is its own landmark again, with all that it had absorbed.

        Raises:
            FactorGraphError: no merge is in force.
        """
        last = self._landmarks.last_merge
        if last is None:
            raise FactorGraphError("no landmarks are merged, so no merge can be undone")
        self._move(last.dropped, lambda: self._landmarks.undo(last))

    def _move(self, landmark: int, rename: Callable[[], object]) -> None:
        """Take the observations of a landmark, and of those merged into it, along to its new variable."""
        observations = [self.factors[number] for number in self._landmarks.factors_of(landmark)]
        self.remove_landmark(landmark)
        rename()
        self.add_observations([o for o in observations if isinstance(o, Observation)])

    def _canonical(self, observation: Observation) -> Observation:
        """The observation of the variable that its landmark has in the graph."""
        variable = self._landmarks.variable_of(observation.landmark)
        return observation if variable == observation.landmark else replace(observation, landmark=variable)

    def _enter(self, landmark: int) -> None:
        """Take a landmark in that is not in the graph."""
        if not self._landmarks.enter(landmark):
            return
        variable = self._landmarks.variable_of(landmark)
        if variable in self._known_positions:
            known, sigmas_m = self._known_positions[variable]
            self._solver.insert_landmark(variable, known)
            self._landmark_priors[variable] = self._add(LandmarkPrior(variable, known, sigmas_m))

    def update(self) -> None:
        """Bring the incremental estimate up to date with all that was added and removed."""
        self._solver.update()

    def settle(self) -> BatchSolver:
        """End the incremental estimate: from now on all observations are used, and updates are steps in batch."""
        self.update()
        new = {
            variable: last
            for variable, numbers in self._landmarks.factors_of_variables()
            if not self._solver.holds_landmark(variable) and isinstance(last := self.factors[numbers[-1]], Observation)
        }
        positions = self._positions_map(list(new.values()))
        self._solver = settled = self._solver.settle(dict(zip(new, positions, strict=True)))
        return settled

    def optimize(self) -> Optimization:
        """Solve the whole graph at once, from the incremental estimate."""
        return self.settle().optimize()

    def pose(self, keyframe: int) -> FloatArray:
        """``T_map_body`` (4, 4) of a keyframe."""
        if keyframe in self._fixed_poses:
            return self._fixed_poses[keyframe]
        return self._solver.pose(keyframe)

    def poses(self) -> FloatArray:
        """``T_map_body`` (K, 4, 4) of all keyframes, in the order of ``keyframes``."""
        self.update()
        values = self._solver.estimate()
        fixed = self._fixed_poses
        return np.array([fixed.get(k, values.atPose3(X(k)).matrix()) for k in self._keyframes]).reshape(-1, 4, 4)

    def landmark_positions(self, landmarks: IntArray) -> FloatArray:
        """Positions (N, 3) m in the map of landmarks that are in the graph."""
        self._check_landmarks(landmarks)
        values = self.settle().estimate()
        return np.array([values.atPoint3(L(int(i))) for i in landmarks]).reshape(-1, 3)

    def estimates(self) -> Estimates:
        """Where everything is as far as it is known now; nothing is solved for it."""
        return self._solver.estimates()

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
            observation_landmark_ids=tuple(str(self._landmarks.variable_of(o.landmark)) for o in observations),
            observation_positions=np.array([o.position for o in observations]).reshape(-1, 3),
            observation_covariances=np.array([o.covariance_inflation * o.covariance for o in observations]).reshape(
                -1, 3, 3
            ),
            pose_covariances=self._pose_covariances_if_known(),
            observation_redundancies=_covariance_inflations(observations),
        )

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
        values = self.settle().estimate()
        if self._marginals is None or self._marginals[0] is not values:
            with self._calls.doing("the marginal covariances"):
                self._marginals = values, self._compute_marginals(values)
        return self._marginals[1]

    def _compute_marginals(self, values: gtsam.Values) -> Marginals:
        try:
            records = [self.factors[number] for number in self.settle().numbers]
            return compute_marginals(self.settle().graph, values, records, self._config)
        except np.linalg.LinAlgError as error:
            logger.info("the marginals come one by one from the incremental solver: %s", error)
            return marginals_one_by_one(self.settle().graph, values)

    def _check_landmarks(self, landmarks: IntArray) -> None:
        variables = self._landmarks.variables
        for landmark in landmarks.tolist():
            if landmark not in variables:
                raise FactorGraphError(f"landmark {landmark} is not in the graph")

    def _insert_keyframe(self, keyframe: int, T_map_body: FloatArray) -> None:
        pose = checked_pose(T_map_body, f"keyframe {keyframe}")
        if self._solver.holds_keyframe(keyframe):
            raise FactorGraphError(f"keyframe {keyframe} is in the graph already")
        self._solver.insert_keyframe(keyframe, pose)
        self._keyframes.append(keyframe)

    def _add(self, record: Factor, factor: gtsam.NonlinearFactor | None = None) -> int:
        number = self._number(record)
        self._solver.add(number, factor if factor is not None else self._factor(record))
        return number

    def _number(self, record: Factor) -> int:
        self._next_factor += 1
        self.factors[self._next_factor - 1] = record
        return self._next_factor - 1

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


def _covariance_inflations(observations: Sequence[Observation]) -> FloatArray:
    """Those of observations (O,), none where all are 1."""
    inflations = np.array([observation.covariance_inflation for observation in observations], dtype=np.float64)
    return inflations if (inflations != 1.0).any() else np.zeros(0)
