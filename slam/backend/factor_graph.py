"""The factor graph: poses of keyframes, positions of landmarks, and the factors between them."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence, Set
from dataclasses import replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X

from logs.messages import FactorGraphRecord
from slam.backend.covariance.marginals import compute_marginals, offset_covariances
from slam.backend.covariance.matched_noise import matched_covariances
from slam.backend.editable_graph import EditableGraph
from slam.backend.factors import PRIOR_SIGMA_RAD, Edge, EdgeKind, Observation, summed
from slam.backend.graph_record import make_graph_record
from slam.backend.solver import Optimization, gtsam_errors
from slam.common.arrays import FloatArray, IntArray
from slam.common.errors import FactorGraphError
from slam.common.geometry import invert

logger = logging.getLogger(__name__)


class FactorGraph(EditableGraph):
    """Incremental estimate during the drive, one batch solution at its end."""

    @property
    def keyframe_variables(self) -> IntArray:
        """Ids (V,) of those that are variables, neither constant nor attached to another one."""
        others = self._attached.anchors.keys() | self._fixed_poses.keys()
        return np.array([keyframe for keyframe in self._keyframes if keyframe not in others], dtype=np.int64)

    @property
    def anchors(self) -> set[int]:
        """Those that others are attached to."""
        return set(self._attached.anchors.values())

    def observers(self) -> dict[int, set[int]]:
        """The keyframes that saw each landmark which has a variable of its own, those merged into it included."""
        found: dict[int, set[int]] = {}
        for landmark, seen in self._observations.items():
            found.setdefault(self._variable_of(landmark), set()).update(each.keyframe for each in seen.values())
        return found

    def add_joining_edge(self, edge: Edge, away: Set[int]) -> int:
        """Tie two stretches together that only a break of the odometry tied: the keyframes ``away``, with one end of
        the edge, and the landmarks that only they saw are first moved as a whole to where the edge puts them.

        No solver would find there: to its robust kernel the edge would be as wrong as any, and an update with the edge
        before the segment is moved would bend both stretches towards each other.
        """
        self.update()
        with gtsam_errors("the joining of two segments"):
            values = self._moved_estimate(edge, away)
            joint = self._attached.edge(edge)
            number = self._number(joint)
            self._replace_edges({**self._relaxed_breaks(away, values), number: joint}, values)
        self.update()
        return number

    def _moved_estimate(self, edge: Edge, away: Set[int]) -> gtsam.Values:
        """The estimate, in which the edge puts keyframes ``away`` and the landmarks that only they saw."""
        T_from, T_to = self.pose(edge.from_keyframe), self.pose(edge.to_keyframe)
        if edge.to_keyframe in away:
            shift = gtsam.Pose3(T_from @ edge.T_from_to @ invert(T_to))
        else:
            shift = gtsam.Pose3(T_to @ invert(edge.T_from_to) @ invert(T_from))
        values = gtsam.Values(self._solver.values())
        for keyframe in away & set(self.keyframe_variables.tolist()):
            values.update(X(keyframe), shift.compose(values.atPose3(X(keyframe))))
        for landmark, keyframes in self.observers().items():
            if landmark not in self._known and keyframes <= away:
                values.update(L(landmark), shift.transformFrom(values.atPoint3(L(landmark))))
        return values

    def _relaxed_breaks(self, away: Set[int], values: gtsam.Values) -> dict[int, Edge]:
        """Breaks of the odometry between keyframes ``away`` and the others, by number, as the estimate has them.

        They hold no information, and would pull at a segment that was moved far.
        """
        relaxed = dict[int, Edge]()
        for number, factor in self._factors.items():
            if isinstance(factor, Edge) and factor.kind == EdgeKind.DISCONTINUITY:
                start, end = factor.from_keyframe, factor.to_keyframe
                if (start in away) != (end in away):
                    T_from_to = invert(self.pose(start, values)) @ self.pose(end, values)
                    relaxed[number] = replace(factor, T_from_to=T_from_to)
        return relaxed

    def restore(self, T_map_body: FloatArray, edges: Sequence[Edge], observations: Sequence[Observation]) -> None:
        """Restore an optimised graph in an empty one: keyframes 0 to K - 1 at (K, 4, 4), the first one held.

        ``edges`` tie all keyframes together; ``observations`` are of landmarks from these.
        """
        for number, T in enumerate(T_map_body):
            self.add_keyframe(number, T)
        for edge in edges:
            self.add_edge(edge)
        self.add_observations(observations)
        self.update()

    def replace_covariances(self, covariances: Mapping[int, FloatArray]) -> None:
        """Give the edges of these numbers other covariances (6, 6)."""
        changed = {
            number: replace(edge, covariance=covariances[number])
            for number, edge in self._factors.items()
            if number in covariances and isinstance(edge, Edge)
        }
        self._replace_edges(changed, self._solver.values_with_new())

    def _replace_edges(self, edges: Mapping[int, Edge], values: gtsam.Values) -> None:
        """Put edges in the place of those of their numbers; the next update solves all from ``values``."""
        self._factors |= edges
        self._solver.restart({number: self._between_factor(edge) for number, edge in edges.items()}, values)

    def optimize(self, *, roughly: bool = False) -> Optimization:
        """Solve the whole graph at once, from the current estimate.

        It ends where the next step would move all variables together by a tenth of a standard deviation, or ``roughly``
        by one: the steps that follow are short ones, on which no fusion of landmarks depends.
        """
        return self._solver.optimize(0.5 if roughly else 0.005)

    def match_noise(self) -> Optimization:
        """Solve the whole graph with the noise of odometry and closures that their residuals show, at the optimum."""
        solver = self._solver
        try:
            with gtsam_errors("the estimation of the noise"):
                self.replace_covariances(matched_covariances(self._factors, solver.factors, solver.values()))
        except FactorGraphError as error:
            logger.info("the noise stays as it is configured: %s", error)
        return self.optimize()

    def log_determinant(self) -> float:
        """Of the information of all variables together, at the current estimate."""
        return self._solver.log_determinant()

    def condense(self, anchors: Mapping[int, int]) -> None:
        """Attach keyframes to others, as they are at the optimum.

        An attached keyframe ceases to be a variable and moves rigidly with its anchor, which takes over what was
        observed from it, summed up. Of its edges those to keyframes that stay remain, but for closures that found it:
        the anchor represents these.

        Raises:
            FactorGraphError: the covariances of the poses are not known; nothing has changed.
        """
        covariances = dict(zip(self._keyframes, self.covariances()[0], strict=True))
        concerned = {*anchors, *anchors.values()}
        observations, edges = dict[int, Observation](), dict[int, Edge]()
        for number, factor in self._factors.items():
            match factor:
                case Observation() if factor.keyframe in concerned:
                    observations[number] = replace(factor, landmark=self._variable_of(factor.landmark))
                case Edge() if factor.from_keyframe in anchors or factor.to_keyframe in anchors:
                    edges[number] = factor
        self._attached.attach(anchors, {keyframe: covariances[keyframe] for keyframe in anchors}, self.pose)
        for edge in edges.values():
            self._add_condensed(edge, anchors)
        self.add_observations(summed([self._attached.observation(each) for each in observations.values()]))
        self.remove_factors([*observations, *edges])
        self._solver.restart({}, self._solver.values_with_new())

    def _add_condensed(self, edge: Edge, anchors: Mapping[int, int]) -> None:
        """Add an edge of newly attached keyframes as one of their anchors, if it relates variables that stay."""
        if edge.to_keyframe in anchors and (edge.from_keyframe in anchors or edge.kind == EdgeKind.LOOP_CLOSURE):
            return
        moved = self._attached.edge(edge)
        if moved.from_keyframe != moved.to_keyframe:
            self.add_edge(replace(moved, kind=EdgeKind.CONDENSED) if edge.kind == EdgeKind.ODOMETRY else moved)

    def poses(self, keyframes: IntArray | None = None) -> FloatArray:
        """``T_map_body`` (K, 4, 4) of all keyframes, as ``keyframes`` has them, or of some (K,); nothing is solved."""
        values = self._solver.values_with_new()
        wanted = self._keyframes if keyframes is None else keyframes.tolist()
        return np.array([self.pose(keyframe, values) for keyframe in wanted]).reshape(-1, 4, 4)

    def landmark_positions(self, landmarks: IntArray) -> FloatArray:
        """Positions (N, 3) m in the map of landmarks that are in the graph; nothing is solved."""
        values = self._solver.values_with_new()
        return np.array([values.atPoint3(L(landmark)) for landmark in landmarks.tolist()]).reshape(-1, 3)

    def covariances(self) -> tuple[FloatArray, FloatArray]:
        """Marginal covariances at the current estimate: of all keyframes (K, 6, 6), and of all landmarks (L, 3, 3) m^2
        in the map frame, as ``keyframes`` and ``landmarks`` have them.

        Those of keyframes: rotation [rad] before translation [m], of the right perturbation ``T_map_body Exp(xi)``:
        about the body's axes.

        Raises:
            FactorGraphError: the graph does not determine all variables.
        """
        self.update()
        with gtsam_errors("the marginal covariances"):
            marginals = compute_marginals(self._solver.factors.values(), self._solver.values())
        sigmas = np.repeat([PRIOR_SIGMA_RAD, self.prior_sigma_m], 3)
        known = dict.fromkeys(self._fixed_poses, np.diag(sigmas**2)) | self._attached.covariances
        poses = [known[each] if each in known else marginals[X(each)] for each in self._keyframes]
        landmarks = [marginals[L(landmark)] for landmark in self.landmarks.tolist()]
        return np.array(poses).reshape(-1, 6, 6), np.array(landmarks).reshape(-1, 3, 3)

    def relative_covariances(self, pairs: IntArray) -> FloatArray:
        """Covariances (P, 3, 3) m^2 of the offset between the landmarks of each pair (P, 2), in the map frame.

        Raises:
            FactorGraphError: the graph does not determine all variables.
        """
        self.update()
        keys = [(L(a), L(b)) for a, b in pairs.tolist()]
        with gtsam_errors("the covariances of landmarks"):
            return offset_covariances(self._solver.factors.values(), self._solver.values(), keys)

    def to_record(
        self, stamp_ns: int, keyframe_stamps_ns: IntArray, pose_covariances: FloatArray | None = None
    ) -> FactorGraphRecord:
        """The whole graph at its current estimate, as a record of a log; ``pose_covariances`` (K, 6, 6), if known."""
        factors = [*self._factors.values(), *self._attached.rigid_edges(self.prior_sigma_m)]
        record = make_graph_record(
            stamp_ns, self.keyframes, keyframe_stamps_ns, self.poses(), factors, self._variable_of
        )
        return record if pose_covariances is None else replace(record, pose_covariances=pose_covariances)
