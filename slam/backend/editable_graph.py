"""Factors and variables of the graph: added, changed and removed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import count

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X

from slam.backend.factors import (
    OBSERVATION_KERNEL_WIDTH,
    PRIOR_SIGMA_RAD,
    Edge,
    EdgeKind,
    Factor,
    Observation,
    between_factor,
    checked_pose,
    landmark_prior_factor,
    observation_factors,
    prior_factor,
)
from slam.backend.solver import Solver
from slam.common.arrays import FloatArray, IntArray
from slam.common.calibration import DetectionCalibration
from slam.common.geometry import adjoint, invert


class AttachedKeyframes:
    """Keyframes that are not variables of the graph, as each moves rigidly with another one, its anchor: rewrites their
    factors as factors of anchors.
    """

    def __init__(self) -> None:
        self.anchors: dict[int, int] = {}
        """The anchor of each attached keyframe."""
        self._transforms: dict[int, FloatArray] = {}
        self.covariances: dict[int, FloatArray] = {}
        """Of the pose (6, 6) of each attached keyframe, as it was when it was attached."""

    def attach(
        self, anchors: Mapping[int, int], covariances: Mapping[int, FloatArray], pose: Callable[[int], FloatArray]
    ) -> None:
        """Attach keyframes to their anchors, which stay variables, as their poses (4, 4) in the map are now, with
        ``covariances`` (6, 6).
        """
        self.covariances |= covariances
        self._transforms |= {each: invert(pose(anchor)) @ pose(each) for each, anchor in anchors.items()}
        self.anchors |= anchors

    def pose(self, keyframe: int, T_map_anchor: FloatArray) -> FloatArray:
        """``T_map_body`` (4, 4) of an attached keyframe."""
        return T_map_anchor @ self._transforms[keyframe]

    def edge(self, edge: Edge) -> Edge:
        """The same constraint between anchors; covariances are about the axes of the keyframe that it leads to."""
        T_from_to, covariance = edge.T_from_to, edge.covariance
        start, end = edge.from_keyframe, edge.to_keyframe
        if start in self.anchors:
            T_from_to = self._transforms[start] @ T_from_to
        if end in self.anchors:
            Ad = adjoint(self._transforms[end])
            covariance = Ad @ covariance @ Ad.T
            T_from_to = T_from_to @ invert(self._transforms[end])
        return Edge(self.anchors.get(start, start), self.anchors.get(end, end), T_from_to, covariance, edge.kind)

    def observation(self, observation: Observation) -> Observation:
        """The same observation from the anchor."""
        if observation.keyframe not in self.anchors:
            return observation
        T = self._transforms[observation.keyframe]
        return replace(
            observation,
            keyframe=self.anchors[observation.keyframe],
            position=T[:3, :3] @ observation.position + T[:3, 3],
            covariance=T[:3, :3] @ observation.covariance @ T[:3, :3].T,
        )

    def rigid_edges(self, sigma_m: float) -> list[Edge]:
        """An edge from the anchor of each to it, as stiff as the prior of the first keyframe."""
        covariance = np.diag(np.repeat([PRIOR_SIGMA_RAD, sigma_m], 3) ** 2)
        return [
            Edge(anchor, keyframe, self._transforms[keyframe], covariance, EdgeKind.CONDENSED)
            for keyframe, anchor in self.anchors.items()
        ]


class EditableGraph:
    """Factors by numbers that never change, each as a record and as a factor of the solver in use.

    ``sensor_range_m``: of the detections; ``kernel_width``: of the observations' Cauchy kernel, in standard deviations;
    ``prior_sigma_m``: standard deviation of what is fixed.
    """

    def __init__(
        self,
        *,
        sensor_range_m: float = DetectionCalibration().sensor_range_m,
        kernel_width: float = OBSERVATION_KERNEL_WIDTH,
    ) -> None:
        self.prior_sigma_m = 1e-3 / 30.0 * sensor_range_m
        self._kernel_width = kernel_width
        self._sensor_range_m = sensor_range_m
        self._solver = Solver(sensor_range_m=sensor_range_m)
        self._factors: dict[int, Factor] = {}
        self._numbers = count()
        self._keyframes: dict[int, None] = {}  # in the order in which they were added
        self._attached = AttachedKeyframes()
        self._fixed_poses: dict[int, FloatArray] = {}  # of keyframes that are no variables
        self._observations: dict[int, dict[int, Observation]] = {}  # by the landmark, by their numbers
        self._aliases: dict[int, int] = {}
        self._known: dict[int, gtsam.PriorFactorPoint3] = {}  # of landmarks of a prior map
        self._fixed_landmarks: set[int] = set()

    @property
    def factors(self) -> Mapping[int, Factor]:
        """The active factors, by their numbers."""
        return self._factors

    @property
    def keyframes(self) -> IntArray:
        """Ids (K,) of the keyframes, in the order in which they were added."""
        return np.array([*self._keyframes], dtype=np.int64)

    @property
    def landmarks(self) -> IntArray:
        """Ids (L,) of the landmarks that are estimated, ascending; those of a fixed map are constants and left out."""
        variables = {self._variable_of(landmark) for landmark in self._observations}
        return np.array(sorted(variables - self._fixed_landmarks), dtype=np.int64)

    def add_keyframe(self, keyframe: int, T_map_body: FloatArray) -> None:
        """Add a keyframe at a pose (4, 4), which edges have to tie to the others before the next update.

        The first one has a prior, which fixes the map frame.
        """
        pose = checked_pose(T_map_body, f"keyframe {keyframe}")
        prior = None if self._keyframes else prior_factor(keyframe, pose, self.prior_sigma_m)
        self._solver.insert(X(keyframe), pose, prior)
        self._keyframes[keyframe] = None

    def add_fixed_keyframe(self, keyframe: int, T_map_body: FloatArray) -> None:
        """Add a keyframe that never moves: a constant. Edges lead from it to others."""
        checked_pose(T_map_body, f"keyframe {keyframe}")
        self._keyframes[keyframe] = None
        self._fixed_poses[keyframe] = T_map_body

    def add_next_keyframe(self, edge: Edge, T_from_to: FloatArray | None = None) -> None:
        """Add the keyframe ``edge.to_keyframe``, placed from ``edge.from_keyframe`` by the edge.

        ``T_from_to`` (4, 4), if given, is a better initial estimate until the next update.
        """
        placed_by = edge.T_from_to if T_from_to is None else T_from_to
        self.add_keyframe(edge.to_keyframe, self.pose(edge.from_keyframe) @ placed_by)
        self.add_edge(edge)

    def add_known_landmarks(self, landmarks: Mapping[int, FloatArray], sigmas_m: FloatArray, *, is_fixed: bool) -> None:
        """Announce landmarks of a prior map; each enters the graph when something is merged into it.

        Args:
            landmarks: their positions, (3,) m by id.
            sigmas_m: (3,) standard deviations of the coordinates.
            is_fixed: they are constants, and not estimated.
        """
        for landmark, position in landmarks.items():
            self._known[landmark] = landmark_prior_factor(landmark, position, sigmas_m)
        if is_fixed:
            self._fixed_landmarks.update(landmarks)

    def add_edge(self, edge: Edge) -> int:
        """Add a factor between two keyframes; returns its number."""
        edge = self._attached.edge(edge)
        factor, number = self._between_factor(edge), self._number(edge)
        self._solver.add(number, factor)
        return number

    def add_observations(self, observations: Sequence[Observation]) -> None:
        """Add factors between landmarks and the keyframes that observed them.

        A landmark enters the graph with its first observation, which gives it all three coordinates, so none is ever
        under-constrained.
        """
        seen = [self._attached.observation(each) for each in observations]
        self._insert({self._number(each): each for each in seen})

    def break_before(self, edge: Edge) -> None:
        """Replace the odometry to a keyframe by an edge, and remove what was observed from there on."""
        self.remove_factors(
            [
                number
                for number, each in self._factors.items()
                if (isinstance(each, Observation) and each.keyframe >= edge.to_keyframe)
                or (isinstance(each, Edge) and each.kind == EdgeKind.ODOMETRY and each.to_keyframe == edge.to_keyframe)
            ]
        )
        self.add_edge(edge)

    def remove_factors(self, numbers: Iterable[int]) -> None:
        """Remove factors, and landmarks without any other observation."""
        for number in numbers:
            self._solver.remove(number)
            factor = self._factors.pop(number)
            if isinstance(factor, Observation):
                del self._observations[factor.landmark][number]
                if not self._observations[factor.landmark]:
                    del self._observations[factor.landmark]

    def remove_landmarks(self, landmarks: Iterable[int]) -> None:
        """Remove all observations of landmarks; those that are not in the graph are ignored."""
        self.remove_factors([number for each in landmarks for number in self._observations.get(each, ())])

    def alias_landmarks(self, aliases: Mapping[int, int]) -> None:
        """Set the landmark that each merged landmark was merged into, by the id of the merged one.

        Observations of a landmark, earlier and later ones, count as those of the one that it was merged into.
        """
        moved = {
            number: each
            for landmark, seen in self._observations.items()
            if aliases.get(landmark, landmark) != self._variable_of(landmark)
            for number, each in seen.items()
        }
        self._aliases = dict(aliases)
        for number, each in moved.items():
            self._solver.remove(number)
            self._observations.pop(each.landmark, None)
        self._insert(moved)

    def update(self) -> None:
        """Bring the incremental estimate up to date with all that was added and removed."""
        self._solver.update()

    def pose(self, keyframe: int, values: gtsam.Values | None = None) -> FloatArray:
        """``T_map_body`` (4, 4) of a keyframe; ``values``: of the variables, instead of their current estimates."""
        anchor = self._attached.anchors.get(keyframe)
        if anchor is not None:
            return self._attached.pose(keyframe, self.pose(anchor, values))
        if keyframe in self._fixed_poses:
            return self._fixed_poses[keyframe]
        return self._solver.pose(keyframe) if values is None else values.atPose3(X(keyframe)).matrix()

    def observed_positions(self, landmarks: IntArray) -> FloatArray:
        """Positions (N, 3) m in the map of landmarks by their own observations, without those of landmarks that were
        merged into them, from the poses of the keyframes; NaN for landmarks without any.
        """
        seen = [
            (row, each)
            for row, landmark in enumerate(landmarks.tolist())
            for each in self._observations.get(landmark, {}).values()
        ]
        rows = np.array([row for row, _ in seen], dtype=np.int64)
        weights = np.array([1.0 / (each.covariance_inflation * np.trace(each.covariance)) for _, each in seen])
        in_map = weights[:, None] * self._in_map([each for _, each in seen])
        sums = np.stack([np.bincount(rows, axis, len(landmarks)) for axis in in_map.T], axis=1)
        totals = np.bincount(rows, weights, len(landmarks))[:, None]
        return np.asarray(np.divide(sums, totals, out=np.full(sums.shape, np.nan), where=totals > 0.0))

    def _in_map(self, observations: Sequence[Observation]) -> FloatArray:
        """Positions (N, 3) m in the map of what was observed, from the poses of the keyframes."""
        poses = {keyframe: self.pose(keyframe) for keyframe in dict.fromkeys(each.keyframe for each in observations)}
        T = np.array([poses[each.keyframe] for each in observations]).reshape(-1, 4, 4)
        in_body = np.array([each.position for each in observations]).reshape(-1, 3, 1)
        return np.asarray((T[:, :3, :3] @ in_body)[..., 0] + T[:, :3, 3])

    def _variable_of(self, landmark: int) -> int:
        """The landmark that this one was merged into, or itself."""
        return self._aliases.get(landmark, landmark)

    def _number(self, record: Factor) -> int:
        number = next(self._numbers)
        self._factors[number] = record
        return number

    def _insert(self, observations: Mapping[int, Observation]) -> None:
        """Hand observations, by their numbers, to the solver; each is of the variable of its landmark."""
        seen = [replace(each, landmark=self._variable_of(each.landmark)) for each in observations.values()]
        factors = observation_factors(seen, self._kernel_width, sensor_range_m=self._sensor_range_m)
        for (number, each), factor, position in zip(observations.items(), factors, self._in_map(seen), strict=True):
            self._observations.setdefault(each.landmark, {})[number] = each
            variable = self._variable_of(each.landmark)
            if not self._solver.holds(L(variable)):
                prior = self._known.get(variable)
                self._solver.insert(L(variable), position if prior is None else prior.prior(), prior)
            self._solver.add(number, factor)

    def _between_factor(self, edge: Edge) -> gtsam.NonlinearFactor:
        """The solver's factor of an edge."""
        return between_factor(edge, T_map_from=self._fixed_poses.get(edge.from_keyframe))
