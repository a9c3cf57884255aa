"""The factor graph: poses of keyframes, positions of landmarks, and the factors between them."""

import logging
from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import replace
from itertools import chain, count

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X

from logs.messages import FactorGraphRecord
from slam.backend.covariance.marginals import compute_marginals, offset_covariances
from slam.backend.covariance.matched_noise import matched_covariances
from slam.backend.factors import (
    EARTH,
    OBSERVATION_KERNEL_WIDTH,
    PRIOR_SIGMA_RAD,
    AttachedKeyframes,
    Edge,
    EdgeKind,
    Factor,
    Observation,
    between_factor,
    checked_pose,
    observation_factors,
    pose_key,
    prior_factor,
    stacked,
    sum_observations,
)
from slam.backend.graph_record import make_graph_record
from slam.backend.solver import Optimization, Solver, gtsam_errors
from slam.common.arrays import FloatArray, IntArray
from slam.common.calibration import DetectionCalibration
from slam.common.errors import FactorGraphError
from slam.common.geometry import apply_each, invert, relative

logger = logging.getLogger(__name__)

ROUGHLY = 0.5
"""Decrease of the cost [nats] below which a step moves all variables together by less than a standard deviation."""


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
        self._prior_sigmas = np.repeat([PRIOR_SIGMA_RAD, self.prior_sigma_m], 3)
        self._kernel_width = kernel_width
        self._sensor_range_m = sensor_range_m
        self._solver = Solver(sensor_range_m=sensor_range_m)
        self.factors: dict[int, Factor] = {}
        """The active ones, by their numbers."""
        self._numbers = count()
        self._keyframes: list[int] = []  # in the order in which they were added
        self._attached = AttachedKeyframes()
        self._fixed_poses: dict[int, FloatArray] = {}  # of keyframes that are no variables
        self._observations: dict[int, dict[int, Observation]] = {}  # by the landmark, by their numbers
        self._aliases: dict[int, int] = {}
        self._known: dict[int, gtsam.PriorFactorPoint3] = {}  # of landmarks of a prior map
        self._fixed_landmarks: set[int] = set()

    @property
    def keyframes(self) -> IntArray:
        """Ids (K,) of the keyframes, in the order in which they were added."""
        return np.array(self._keyframes, dtype=np.int64)

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
        prior = None if self._keyframes else prior_factor(keyframe, pose, self._prior_sigmas)
        self._solver.insert(X(keyframe), pose, prior)
        self._keyframes.append(keyframe)

    def add_fixed_keyframe(self, keyframe: int, T_map_body: FloatArray) -> None:
        """Add a keyframe that never moves: a constant. Edges lead from it to others."""
        checked_pose(T_map_body, f"keyframe {keyframe}")
        self._keyframes.append(keyframe)
        self._fixed_poses[keyframe] = T_map_body

    def add_next_keyframe(self, edge: Edge, T_from_to: FloatArray | None = None) -> None:
        """Add the keyframe ``edge.to_keyframe``, placed from ``edge.from_keyframe`` by the edge.

        ``T_from_to`` (4, 4), if given, is a better initial estimate until the next update.
        """
        placed_by = edge.T_from_to if T_from_to is None else T_from_to
        self.add_keyframe(edge.to_keyframe, self.pose(edge.from_keyframe) @ placed_by)
        self.add_edge(edge)

    def replace_fixes(self, T_map_earth: FloatArray, edges: Sequence[Edge]) -> None:
        """Put edges from ``EARTH``, which is at about (4, 4), in the place of those so far."""
        fixes = self.edges(EdgeKind.GNSS).items()  # those of a prior map lead from its first keyframe
        self.remove_factors([number for number, each in fixes if each.from_keyframe == EARTH])
        if edges:
            pose = checked_pose(T_map_earth, "the frame of fixes")
            # Neither its heading nor its position is known.
            upright = prior_factor(EARTH, pose, np.array([PRIOR_SIGMA_RAD, PRIOR_SIGMA_RAD, *[1e6] * 4]))
            self._solver.insert(pose_key(EARTH), pose, upright)
        for edge in edges:
            self.add_edge(edge)

    def add_known_landmarks(self, landmarks: Mapping[int, FloatArray], sigmas_m: FloatArray, *, is_fixed: bool) -> None:
        """Announce landmarks of a prior map; each enters the graph when something is merged into it.

        Args:
            landmarks: their positions, (3,) m by id.
            sigmas_m: (3,) standard deviations of the coordinates.
            is_fixed: they are constants, and not estimated.
        """
        noise = gtsam.noiseModel.Diagonal.Sigmas(sigmas_m)
        for landmark, position in landmarks.items():
            if not np.isfinite(position).all():
                raise FactorGraphError(f"landmark {landmark}: the position {position} is not finite")
            self._known[landmark] = gtsam.PriorFactorPoint3(L(landmark), position, noise)
        if is_fixed:
            self._fixed_landmarks.update(landmarks)

    def add_edge(self, edge: Edge) -> int:
        """Add a factor between two keyframes; returns its number."""
        edge = self._attached.edge(edge)
        factor, number = between_factor(edge, self._fixed_poses.get(edge.from_keyframe)), self._number(edge)
        self._solver.add(number, factor)
        return number

    def add_observations(self, observations: Sequence[Observation]) -> None:
        """Add factors between landmarks and the keyframes that observed them.

        A landmark enters the graph with its first observation, which gives it all three coordinates, so none is ever
        under-constrained.
        """
        self._insert({self._number(each): each for each in map(self._attached.observation, observations)})

    def edges(self, kind: EdgeKind) -> dict[int, Edge]:
        """The edges of a kind, by their numbers."""
        return {number: each for number, each in self.factors.items() if isinstance(each, Edge) and each.kind == kind}

    def break_before(self, edge: Edge) -> None:
        """Replace the odometry to a keyframe by an edge, and remove what was observed from there on."""
        self.remove_factors(
            [
                number
                for number, each in self.factors.items()
                if (isinstance(each, Observation) and each.keyframe >= edge.to_keyframe)
                or (isinstance(each, Edge) and each.kind == EdgeKind.ODOMETRY and each.to_keyframe == edge.to_keyframe)
            ]
        )
        self.add_edge(edge)

    def remove_factors(self, numbers: Iterable[int]) -> None:
        """Remove factors, and landmarks without any other observation."""
        for number in numbers:
            self._solver.remove(number)
            factor = self.factors.pop(number)
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

    def estimate(self) -> gtsam.Values:
        """The estimate of all variables as of the last update."""
        return self._solver.values()

    def pose(self, keyframe: int, values: gtsam.Values | None = None) -> FloatArray:
        """``T_map_body`` (4, 4) of a keyframe; ``values``: of the variables, instead of their current estimates."""
        anchor = self._attached.anchors.get(keyframe)
        if anchor is not None:
            return self.pose(anchor, values) @ self._attached.transforms[keyframe]
        if keyframe in self._fixed_poses:
            return self._fixed_poses[keyframe]
        key = pose_key(keyframe)
        return self._solver.pose(key) if values is None else values.atPose3(key).matrix()

    def observed_positions(self, landmarks: IntArray) -> FloatArray:
        """Positions (N, 3) m in the map of landmarks by their own observations, without those of landmarks that were
        merged into them, from the poses of the keyframes; NaN for landmarks without any.
        """
        of_landmarks = [self._observations.get(landmark, {}).values() for landmark in landmarks.tolist()]
        rows = np.repeat(np.arange(len(landmarks)), [len(each) for each in of_landmarks])
        seen = [*chain.from_iterable(of_landmarks)]
        keyframes, _, positions, covariances, inflations = stacked(seen)
        weights = 1.0 / (inflations * np.trace(covariances, axis1=1, axis2=2))
        sums = np.zeros((len(landmarks), 3))
        np.add.at(sums, rows, weights[:, None] * self._in_map(keyframes, positions))
        with np.errstate(invalid="ignore"):
            return sums / np.bincount(rows, weights, len(landmarks))[:, None]

    def _in_map(self, keyframes: IntArray, positions: FloatArray) -> FloatArray:
        """Positions (N, 3) m in the map of what was seen at positions (N, 3) m in the bodies of keyframes (N,)."""
        distinct, rows = np.unique(keyframes, return_inverse=True)
        poses = np.array([self.pose(keyframe) for keyframe in distinct.tolist()]).reshape(-1, 4, 4)
        return apply_each(poses[rows], positions)

    def _variable_of(self, landmark: int) -> int:
        """The landmark that this one was merged into, or itself."""
        return self._aliases.get(landmark, landmark)

    def _number(self, record: Factor) -> int:
        number = next(self._numbers)
        self.factors[number] = record
        return number

    def _insert(self, observations: Mapping[int, Observation]) -> None:
        """Hand observations, by their numbers, to the solver; each is of the variable of its landmark."""
        seen = [replace(each, landmark=self._variable_of(each.landmark)) for each in observations.values()]
        factors = observation_factors(seen, self._kernel_width, sensor_range_m=self._sensor_range_m)
        keyframes, _, positions, _, _ = stacked(seen)
        in_map = self._in_map(keyframes, positions)
        for (number, each), factor, position in zip(observations.items(), factors, in_map, strict=True):
            self._observations.setdefault(each.landmark, {})[number] = each
            variable = self._variable_of(each.landmark)
            prior = self._known.get(variable)
            self._solver.insert(L(variable), position if prior is None else prior.prior(), prior)
            self._solver.add(number, factor)


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
            changed = {number: joint}
            for each, gap in self.edges(EdgeKind.DISCONTINUITY).items():
                start, end = gap.from_keyframe, gap.to_keyframe
                # A break holds no information, and would pull at a segment that was moved far.
                if (start in away) != (end in away):
                    T_start_end = relative(self.pose(start, values), self.pose(end, values))
                    changed[each] = replace(gap, T_from_to=T_start_end)
            self.replace_edges(changed, values)
        self.update()
        return number

    def _moved_estimate(self, edge: Edge, away: Set[int]) -> gtsam.Values:
        """The estimate, in which the edge puts keyframes ``away`` and the landmarks that only they saw."""
        T_from, T_to = self.pose(edge.from_keyframe), self.pose(edge.to_keyframe)
        shift = gtsam.Pose3(T_from @ edge.T_from_to @ invert(T_to))
        if edge.from_keyframe in away:
            shift = shift.inverse()
        values = gtsam.Values(self._solver.values())
        for keyframe in away & set(self.keyframe_variables.tolist()):
            values.update(X(keyframe), shift.compose(values.atPose3(X(keyframe))))
        for landmark, keyframes in self.observers().items():
            if landmark not in self._known and keyframes <= away:
                values.update(L(landmark), shift.transformFrom(values.atPoint3(L(landmark))))
        return values

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

    def replace_edges(self, edges: Mapping[int, Edge], values: gtsam.Values | None = None) -> None:
        """Put edges in the place of those of their numbers; the next update solves all from the current estimate, or
        from ``values``.
        """
        self.factors |= edges
        fixed = self._fixed_poses
        changed = {number: between_factor(edge, fixed.get(edge.from_keyframe)) for number, edge in edges.items()}
        self._solver.restart(changed, values or self._solver.values_with_new())

    def settle(self, closure: int) -> None:
        """Solve the whole graph anew if its estimate contradicts a new closure, given by its number, and take what
        contradicts fewer closures: the odometry was weighed against each when it was accepted.
        """
        self.update()
        if self._solver.outliers([closure]):
            self._solver.optimize_anew(ROUGHLY, self.edges(EdgeKind.LOOP_CLOSURE))

    def assume_gaussian_odometry(self) -> None:
        """Solve the whole graph, and take the errors of all steps of the odometry but outliers for Gaussian."""
        self.optimize(roughly=True)
        steps = self.edges(EdgeKind.ODOMETRY)
        outliers = self._solver.outliers(steps)
        self.replace_edges(
            {number: replace(each, is_gaussian=number not in outliers) for number, each in steps.items()}
        )

    def optimize(self, *, roughly: bool = False) -> Optimization:
        """Solve the whole graph at once, from the current estimate.

        It ends where the next step would move all variables together by a tenth of a standard deviation, or ``roughly``
        by one: the steps that follow are short ones, on which no fusion of landmarks depends.
        """
        return self._solver.optimize(ROUGHLY if roughly else 0.01 * ROUGHLY)

    def match_noise(self) -> Optimization:
        """Solve the whole graph with the noise of the odometry that its residuals show, at the optimum."""
        solver = self._solver
        try:
            with gtsam_errors("the estimation of the noise"):
                found = matched_covariances(self.factors, solver.factors, solver.values())
        except FactorGraphError as error:
            logger.info("the noise stays as it is configured: %s", error)
            found = {}
        self.replace_edges(
            {
                number: replace(each, covariance=found.get(number, each.covariance), is_gaussian=False)
                for number, each in self.factors.items()
                if isinstance(each, Edge)
            }
        )
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
        of_poses = dict(zip(self._keyframes, self.covariances()[0], strict=True))
        concerned = {*anchors, *anchors.values()}
        observations, edges = dict[int, Observation](), dict[int, Edge]()
        for number, factor in self.factors.items():
            match factor:
                case Observation() if factor.keyframe in concerned:
                    observations[number] = replace(factor, landmark=self._variable_of(factor.landmark))
                case Edge() if factor.from_keyframe in anchors or factor.to_keyframe in anchors:
                    edges[number] = factor
        self._attached.attach(anchors, {keyframe: of_poses[keyframe] for keyframe in anchors}, self.pose)
        for edge in edges.values():
            is_left_out = edge.to_keyframe in anchors and (
                edge.from_keyframe in anchors or edge.kind == EdgeKind.LOOP_CLOSURE
            )
            moved = self._attached.edge(edge)
            if not is_left_out and moved.from_keyframe != moved.to_keyframe:
                self.add_edge(replace(moved, kind=EdgeKind.CONDENSED) if edge.kind == EdgeKind.ODOMETRY else moved)
        keyframes, landmarks, positions, covariances, inflations = stacked(
            [self._attached.observation(each) for each in observations.values()]
        )
        covariances = inflations[:, None, None] * covariances
        self.add_observations(sum_observations(keyframes, landmarks, positions, covariances, inflations))
        self.remove_factors([*observations, *edges])
        self._solver.restart({}, self._solver.values_with_new())

    def poses(self, keyframes: Iterable[int] | None = None) -> FloatArray:
        """``T_map_body`` (K, 4, 4) of all keyframes, as ``keyframes`` has them, or of some; nothing is solved."""
        values = self._solver.values_with_new()
        wanted = self._keyframes if keyframes is None else keyframes
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
        known = dict.fromkeys(self._fixed_poses, np.diag(self._prior_sigmas**2)) | self._attached.covariances
        poses = [known[each] if each in known else marginals[X(each)] for each in self._keyframes]
        landmarks = [marginals[L(landmark)] for landmark in self.landmarks.tolist()]
        return np.array(poses).reshape(-1, 6, 6), np.array(landmarks).reshape(-1, 3, 3)

    def relative_covariances(self, pairs: IntArray) -> FloatArray:
        """Covariances (P, 3, 3) m^2 of the offset between the landmarks of each pair (P, 2), in the map frame.

        Raises:
            FactorGraphError: the graph does not determine all variables.
        """
        self.update()
        keys = np.vectorize(L, otypes=[np.int64])(pairs)
        with gtsam_errors("the covariances of landmarks"):
            return offset_covariances(self._solver.factors.values(), self._solver.values(), keys)

    def to_record(
        self, stamp_ns: int, keyframe_stamps_ns: IntArray, pose_covariances: FloatArray | None = None
    ) -> FactorGraphRecord:
        """The whole graph at its current estimate, as a record of a log; ``pose_covariances`` (K, 6, 6), if known."""
        edges = [self._recorded(each) for each in self.factors.values() if isinstance(each, Edge)]
        # As stiff as the prior of the first keyframe.
        rigid, attached = np.diag(self._prior_sigmas**2), self._attached
        edges += [
            Edge(anchor, keyframe, attached.transforms[keyframe], rigid, EdgeKind.CONDENSED)
            for keyframe, anchor in attached.anchors.items()
        ]
        observations = [each for each in self.factors.values() if isinstance(each, Observation)]
        record = make_graph_record(
            stamp_ns, self.keyframes, keyframe_stamps_ns, self.poses(), edges, observations, self._variable_of
        )
        return record if pose_covariances is None else replace(record, pose_covariances=pose_covariances)

    def _recorded(self, edge: Edge) -> Edge:
        """An edge as logs have it: fixes lead from the first keyframe, by where the graph has that on earth."""
        if edge.from_keyframe != EARTH:
            return edge
        first = self._keyframes[0]
        T_first_earth = relative(self.pose(first), self.pose(EARTH))
        return replace(edge, from_keyframe=first, T_from_to=T_first_earth @ edge.T_from_to)
