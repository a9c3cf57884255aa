"""The results of a drive, once all is optimised."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from logs.messages import (
    FactorGraphRecord,
    ObjectMapRecord,
    StatusRecord,
    TrajectoryRecord,
)
from slam.backend.batch_solver import Optimization
from slam.backend.factor_graph import FactorGraph
from slam.common.arrays import FloatArray, IntArray
from slam.common.errors import FactorGraphError
from slam.common.geometry import invert
from slam.display.snapshot import MapSnapshot
from slam.localization.pose_output import MAP_FRAME
from slam.object_map.landmarks import ObjectMap
from slam.odometry.interpolation import interpolate_between_keyframes
from slam.odometry.keyframe import Keyframe
from slam.odometry.path import OdometryPath
from slam.trajectory_check.judgement import TrajectoryCheck

logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class FinalMap:
    """Results of a drive."""

    trajectory: TrajectoryRecord
    object_map: ObjectMapRecord
    graph: FactorGraphRecord
    snapshot: MapSnapshot
    status: StatusRecord
    trajectory_check: TrajectoryCheck


@dataclass(frozen=True, slots=True)
class Outcome:
    """Result of the final optimisation, for the user."""

    level: str
    message: str


def judge_outcome(
    optimization: Optimization,
    counters: Counter[str],
    doubts: Sequence[str] = (),
    *,
    uncorrected: str = "",
) -> Outcome:
    """Whether a result can be relied on.

    Args:
        optimization: the last one.
        counters: those of the drive.
        doubts: why the map may be worse than it seems.
        uncorrected: why nothing corrects the odometry, or empty.
    """
    message = "optimised"
    if uncorrected:
        message = f"not corrected, the trajectory is that of the odometry: {uncorrected}"
    elif not optimization.converged:
        message = f"the final optimisation did not converge in {optimization.iterations} iterations"
    unused = counters["odometry_out_of_order"] + counters["odometry_duplicated"]
    is_ordered = unused <= counters["odometry_used"]
    if not is_ordered:
        message += "; most odometry messages were unusable: their stamps do not increase"
    message = "; ".join([message, *doubts])
    has_trouble = not is_ordered or counters["covariances_missing"] or doubts or uncorrected
    return Outcome("info" if optimization.converged and not has_trouble else "warning", message)


class FinalRecords:
    """The final records of an optimised drive, from its graph, object map and track.

    ``keyframes``: all of them, of which those from ``first_keyframe`` on, and the landmarks from ``first_segment`` on,
    are of this drive; ``path``: the odometry; ``stamp_ns``: of the records.
    """

    def __init__(
        self,
        graph: FactorGraph,
        object_map: ObjectMap,
        keyframes: Sequence[Keyframe],
        path: OdometryPath,
        *,
        first_keyframe: int,
        first_segment: int,
        stamp_ns: int,
    ) -> None:
        self._graph = graph
        self._map = object_map
        self._keyframes = keyframes
        self._own_keyframes = keyframes[first_keyframe:]
        self._path = path
        self._first_segment = first_segment
        self._stamp_ns = stamp_ns
        self._T_map_body = graph.poses()[first_keyframe:]

    def trajectory(self) -> TrajectoryRecord:
        """All poses of the odometry, in the map."""
        stamps_ns = self._path.stamps_ns
        T_map_body = interpolate_between_keyframes(
            stamps_ns,
            self._path.T_odom_body,
            np.searchsorted(stamps_ns, [keyframe.odometry.stamp_ns for keyframe in self._own_keyframes]),
            self._T_map_body,
            self._path.segments,
        )
        return TrajectoryRecord(self._stamp_ns, MAP_FRAME, stamps_ns, T_map_body)

    def place_landmarks(self) -> int:
        """Bring the object map to the final estimate; returns of how many landmarks the covariance is not known.

        What never got into the graph has no place in the map but where the odometry put it when it was last seen;
        landmarks of a prior map stay where they were.
        """
        landmarks = self._map.rows
        own = landmarks["segment"] >= self._first_segment
        T_map_local = self._T_map_local_at(landmarks["last_seen_ns"][own])
        R = T_map_local[:, :3, :3]
        positions = np.einsum("nij,nj->ni", R, landmarks["position_local"][own]) + T_map_local[:, :3, 3]
        covariances = R @ landmarks["covariance_local"][own] @ np.swapaxes(R, 1, 2)
        self._map.assign(np.flatnonzero(own), position_map=positions, covariance_map=covariances)
        in_graph = self._graph.landmarks
        self._map.assign(in_graph, position_map=self._graph.landmark_positions(in_graph))
        try:
            self._map.assign(in_graph, covariance_map=self._graph.landmark_covariances(in_graph))
        except FactorGraphError as error:
            # The map is worth having without them; what stands there then is the covariance relative to the robot.
            logger.warning("the map has local covariances only: %s", error)
            return len(in_graph)
        return 0

    def _T_map_local_at(self, stamps_ns: IntArray) -> FloatArray:
        """``T_map_local`` (N, 4, 4) of the last keyframes before the stamps (N,)."""
        T_local_body = np.stack([keyframe.T_local_body for keyframe in self._own_keyframes])
        keyframe_stamps_ns = [keyframe.odometry.stamp_ns for keyframe in self._own_keyframes]
        before = np.maximum(np.searchsorted(keyframe_stamps_ns, stamps_ns, side="right") - 1, 0)
        return np.asarray((self._T_map_body @ invert(T_local_body))[before])

    def object_map(self) -> ObjectMapRecord:
        """All landmarks, as ``place_landmarks`` left them."""
        return self._map.to_record(self._stamp_ns)

    def graph(self) -> FactorGraphRecord:
        """The factors, with the estimates of all keyframes."""
        stamps_ns = np.array([keyframe.odometry.stamp_ns for keyframe in self._keyframes], dtype=np.int64)
        return self._graph.to_record(self._stamp_ns, stamps_ns)
