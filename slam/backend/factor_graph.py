"""The factor graph: poses of keyframes, positions of landmarks, and the factors between them."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from gtsam.symbol_shorthand import L, X

from logs.messages import FactorGraphRecord
from slam.backend.batch_solver import BatchSolver, GtsamCalls, Optimization
from slam.backend.covariance.current_marginals import CurrentMarginals
from slam.backend.covariance.marginals import Marginals
from slam.backend.estimates import Estimates
from slam.backend.factor_store import FactorStore
from slam.backend.factors import (
    PRIOR_SIGMA_RANGES,
    Edge,
    Factor,
    Observation,
    PosePrior,
    between_factor,
)
from slam.backend.graph_record import make_graph_record
from slam.backend.solver_options import FactorGraphConfig
from slam.common.arrays import FloatArray, IntArray
from slam.common.calibration import DetectionCalibration
from slam.common.errors import FactorGraphError

logger = logging.getLogger(__name__)


class FactorGraph:
    """Incremental estimate while the drive goes on, one batch solution at its end.

    Each factor has a number that never changes. ``sensor_range_m`` is that of the detections, ``prior_sigma_m`` the
    standard deviation of what is fixed.
    """

    def __init__(
        self, config: FactorGraphConfig, *, sensor_range_m: float = DetectionCalibration().sensor_range_m
    ) -> None:
        self.prior_sigma_m = PRIOR_SIGMA_RANGES * sensor_range_m
        self._calls = GtsamCalls()
        self._store = FactorStore(config, self._calls, sensor_range_m=sensor_range_m)
        self._marginals = CurrentMarginals(config, self._calls)
        self._keyframes: list[int] = []

    @property
    def factors(self) -> Mapping[int, Factor]:
        """The factors that are in force, by their numbers."""
        return self._store.factors

    @property
    def solver_seconds(self) -> float:
        """Time spent inside GTSAM."""
        return self._calls.seconds

    @property
    def keyframes(self) -> IntArray:
        """Ids (K,) of the keyframes, in the order in which they were added."""
        return np.array(self._keyframes, dtype=np.int64)

    @property
    def keyframe_variables(self) -> IntArray:
        """Ids (V,) of those that are variables: all but those attached to another one."""
        attached = self._store.attached.anchors
        return np.array([keyframe for keyframe in self._keyframes if keyframe not in attached], dtype=np.int64)

    @property
    def landmarks(self) -> IntArray:
        """Ids (L,) of the landmarks that are estimated, ascending; a merged one has the id of the landmark
        it was merged into; those of a fixed map are constants and left out.
        """
        return np.array(sorted(self._store.landmarks.variables - self._store.known.fixed_landmarks), dtype=np.int64)

    def add_first_keyframe(self, keyframe: int, T_map_body: FloatArray) -> None:
        """Fix the map frame: a prior on the first keyframe."""
        self._insert_keyframe(keyframe, T_map_body)
        self._store.add(PosePrior(keyframe, T_map_body, self.prior_sigma_m))

    def add_next_keyframe(self, edge: Edge, T_from_to: FloatArray | None = None) -> None:
        """Add the keyframe ``edge.to_keyframe``, placed from ``edge.from_keyframe`` by the edge.

        ``T_from_to`` (4, 4) is a better estimate to place it by, where there is one, until the next update.
        """
        factor = between_factor(edge)
        placed_by = edge.T_from_to if T_from_to is None else T_from_to
        self._insert_keyframe(edge.to_keyframe, self.pose(edge.from_keyframe) @ placed_by)
        self._store.add(edge, factor)

    def add_keyframe(self, keyframe: int, T_map_body: FloatArray) -> None:
        """Add a keyframe at a pose (4, 4), which edges have to tie to the others before the next update."""
        self._insert_keyframe(keyframe, T_map_body)

    def add_fixed_keyframe(self, keyframe: int, T_map_body: FloatArray, *, is_map_frame: bool = False) -> None:
        """Add a keyframe that never moves; ``is_map_frame``: it stands for the frame of a map without keyframes."""
        self._insert_keyframe(keyframe, T_map_body)
        self._store.add(PosePrior(keyframe, T_map_body, self.prior_sigma_m))
        self._store.known.add_keyframe(keyframe, T_map_body)
        if is_map_frame:
            self._store.known.frame = keyframe

    def add_known_landmarks(self, landmarks: Mapping[int, FloatArray], sigmas_m: FloatArray, *, is_fixed: bool) -> None:
        """Announce landmarks of a prior map; each enters the graph when something is merged into it.

        Args:
            landmarks: their positions, (3,) m by id.
            sigmas_m: (3,) standard deviations of the coordinates.
            is_fixed: they are constants, and not estimated.
        """
        self._store.known.add_landmarks(landmarks, sigmas_m, is_fixed=is_fixed)

    def add_edge(self, edge: Edge) -> int:
        """Tie two keyframes together; returns the factor's number."""
        self._check_ends(edge)
        return self._store.add(edge)

    def add_joining_edge(self, edge: Edge, moved: IntArray) -> int:
        """Tie two stretches together that only a break of the odometry tied: the keyframes ``moved`` (K,), with one end
        of the edge, and the landmarks that only they saw are first moved as a whole to where the edge puts them.

        No solver would find there: to its robust kernel the edge would be as wrong as any, and an update with the edge
        before the segment is moved would bend both stretches towards each other.
        """
        self._check_ends(edge)
        self.update()
        with self._calls.doing("the joining of two segments"):
            return self._store.join(edge, set(moved.tolist()), self.keyframe_variables.tolist())

    def _check_ends(self, edge: Edge) -> None:
        for keyframe in (edge.from_keyframe, edge.to_keyframe):
            if not self._store.holds_keyframe(keyframe):
                raise FactorGraphError(
                    f"edge {edge.from_keyframe} -> {edge.to_keyframe}: keyframe {keyframe} is not in the graph"
                )

    def add_observations(self, observations: Sequence[Observation]) -> None:
        """Tie landmarks to the keyframes that saw them.

        A landmark enters the graph with its first observation, which gives it all three coordinates, so none is ever
        under-constrained.
        """
        self._store.add_observations(observations)

    def replace_covariances(self, covariances: Mapping[int, FloatArray]) -> None:
        """Give the edges of these numbers other covariances (6, 6); all is solved in batch from then on."""
        changed = {
            number: replace(edge, covariance=covariances[number])
            for number, edge in self.factors.items()
            if number in covariances and isinstance(edge, Edge)
        }
        if changed:
            self._store.change(changed)

    def observers(self) -> dict[int, set[int]]:
        """The keyframes that saw each landmark which has a variable of its own, those merged into it included."""
        return self._store.observers()

    def remove_factor(self, number: int) -> None:
        """Take a factor out again; a landmark without observations leaves the graph with its last one."""
        self._store.remove(number)

    def remove_landmark(self, landmark: int) -> None:
        """Take a landmark, with all that was merged into it, and all observations of it out of the graph.

        Nothing happens if it is not in it.
        """
        self._store.remove_landmark(landmark)

    def merge_landmarks(self, kept: int, dropped: int) -> None:
        """Merge two landmarks: observations of ``dropped``, now or later, are observations of ``kept``.

        What they were merged into before is merged; nothing happens if they are one already.
        """
        self._store.merge_landmarks(kept, dropped)

    def undo_merge(self) -> None:
        """Undo the last merge in force: what was dropped is its own landmark again, with all that it had absorbed.

        Raises:
            FactorGraphError: no merge is in force.
        """
        self._store.undo_merge()

    def update(self) -> None:
        """Bring the incremental estimate up to date with all that was added and removed."""
        self._store.solver.update()

    def settle(self) -> BatchSolver:
        """End the incremental estimate: from now on all observations are used, and updates are steps in batch."""
        return self._store.settle()

    def optimize(self, *, roughly: bool = False) -> Optimization:
        """Solve the whole graph at once, from the incremental estimate; ``roughly``: to a standard deviation."""
        return self.settle().optimize(roughly=roughly)

    def pose(self, keyframe: int) -> FloatArray:
        """``T_map_body`` (4, 4) of a keyframe."""
        return self._store.pose(keyframe)

    def poses(self, keyframes: IntArray | None = None) -> FloatArray:
        """``T_map_body`` (K, 4, 4) of all keyframes, in the order of ``keyframes``, or of some (K,)."""
        self.update()
        values, fixed = self._store.solver.estimate(), self._store.known.poses

        def pose(keyframe: int) -> FloatArray:
            return fixed.get(keyframe, values.atPose3(X(keyframe)).matrix())

        wanted = self._keyframes if keyframes is None else keyframes.tolist()
        return self._store.attached.poses(wanted, pose)

    def condense(self, anchors: Mapping[int, int]) -> None:
        """Attach keyframes to others, as they are at the optimum; the incremental estimate goes on from there.

        An attached keyframe is no variable any more and moves rigidly with its anchor, which takes over what was
        observed from it.
        """
        self._store.condense(anchors)

    def landmark_positions(self, landmarks: IntArray) -> FloatArray:
        """Positions (N, 3) m in the map of landmarks that are in the graph."""
        self._check_landmarks(landmarks)
        values = self.settle().estimate()
        return np.array([values.atPoint3(L(int(i))) for i in landmarks]).reshape(-1, 3)

    def estimates(self) -> Estimates:
        """Where everything is as far as it is known now; nothing is solved for it."""
        estimates, attached = self._store.solver.estimates(), np.array(list(self._store.attached.anchors))
        return estimates.with_keyframes(attached, self.poses(attached)[:, :3, 3]) if len(attached) else estimates

    def to_record(self, stamp_ns: int, keyframe_stamps_ns: IntArray) -> FactorGraphRecord:
        """The whole graph at its current estimate, as it goes into a log."""
        return make_graph_record(
            stamp_ns,
            self.keyframes,
            keyframe_stamps_ns,
            self.poses(),
            [*self.factors.values(), *self._store.attached.rigid_edges(self.prior_sigma_m)],
            self._store.landmarks.variable_of,
            self._pose_covariances_if_known(),
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
        if not self._keyframes:
            return np.zeros((0, 6, 6))
        attached = self._store.attached
        anchors = [attached.anchors.get(keyframe, keyframe) for keyframe in self._keyframes]
        of_anchors = self._all_marginals().of_keyframes(np.array(anchors, dtype=np.int64))
        return attached.covariances(self._keyframes, of_anchors)

    def _pose_covariances_if_known(self) -> FloatArray:
        try:
            return self.pose_covariances()
        except FactorGraphError as error:
            logger.warning("the graph is logged without covariances of its poses: %s", error)
            return np.zeros((0, 6, 6))

    def _all_marginals(self) -> Marginals:
        return self._marginals.of(self.settle(), self.factors)

    def _check_landmarks(self, landmarks: IntArray) -> None:
        variables = self._store.landmarks.variables
        for landmark in landmarks.tolist():
            if landmark not in variables:
                raise FactorGraphError(f"landmark {landmark} is not in the graph")

    def _insert_keyframe(self, keyframe: int, T_map_body: FloatArray) -> None:
        self._store.insert_keyframe(keyframe, T_map_body)
        self._keyframes.append(keyframe)
