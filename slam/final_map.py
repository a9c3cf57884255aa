"""The results of a drive, once all is optimised."""

import logging
from collections import Counter
from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from logs.messages import FactorGraphRecord, ObjectMapRecord, StatusRecord, TrajectoryRecord
from logs.records import frozen
from slam.backend.factor_graph import FactorGraph
from slam.backend.solver import Optimization
from slam.common.arrays import FloatArray, IntArray
from slam.common.errors import FactorGraphError
from slam.common.geometry import apply_each, blend, invert
from slam.display.map_topics import MAP_FRAME, Message
from slam.object_map.landmarks import LandmarkState, ObjectMap
from slam.odometry.keyframe import Keyframe
from slam.odometry.track import OdometryPath
from slam.trajectory_check.judgement import TrajectoryCheck

logger = logging.getLogger(__name__)


@frozen
class FinalMap:
    """Results of a drive."""

    trajectory: TrajectoryRecord
    object_map: ObjectMapRecord
    graph: FactorGraphRecord
    snapshot: Sequence[Message]
    status: StatusRecord
    trajectory_check: TrajectoryCheck


def judge_outcome(
    optimization: Optimization, counters: Counter[str], doubts: Sequence[str] = (), *, uncorrected: str = ""
) -> tuple[str, str]:
    """The level and the message of the final status: whether a result can be relied on.

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
    return "info" if optimization.converged and not has_trouble else "warning", message


def find_passed(object_map: ObjectMap, segment: int, places: FloatArray, radius_m: float) -> IntArray:
    """Rows (K,) of the confirmed landmarks of a segment that were passed at six keyframes.

    Args:
        object_map: at the end of the drive.
        segment: of the landmarks.
        places: (P, 3) m in the map, of keyframes.
        radius_m: all objects so near to a keyframe have been seen there.
    """
    landmarks = object_map.rows
    rows = np.flatnonzero((landmarks["state"] == LandmarkState.CONFIRMED) & (landmarks["segment"] == segment))
    positions = landmarks["position_map"][rows, :2]
    counts = cKDTree(places[:, :2]).query_ball_point(positions, radius_m, return_length=True)
    return rows[counts >= 6]


def final_trajectory(
    path: OdometryPath, keyframes: Sequence[Keyframe], T_map_keyframe: FloatArray, stamp_ns: int
) -> TrajectoryRecord:
    """All poses of the odometry in the map.

    Each pose is predicted from the keyframe before it and from the one after it, and is blended between the two by
    time, so that it meets both keyframes and has no step at either. If only one of them is of the segment of the pose,
    it alone decides.

    Args:
        path: of the drive.
        keyframes: (K,) of this drive; the first pose is the first of them.
        T_map_keyframe: (K, 4, 4) m, optimised.
        stamp_ns: of the record.
    """
    stamps_ns, segments, T_odom_body = path.stamps_ns, path.segments, path.T_odom_body
    rows = np.searchsorted(stamps_ns, [keyframe.odometry.stamp_ns for keyframe in keyframes])
    before = np.searchsorted(rows, np.arange(len(stamps_ns)), side="right") - 1
    after = np.minimum(before + 1, len(rows) - 1)
    after = np.where(segments[rows[after]] == segments, after, before)
    before = np.where(segments[rows[before]] == segments, before, after)
    T_before, T_after = (
        T_map_keyframe[each] @ invert(T_odom_body[rows[each]]) @ T_odom_body for each in (before, after)
    )
    start, end = stamps_ns[rows[before]], stamps_ns[rows[after]]
    fraction = np.where(end > start, (stamps_ns - start) / np.maximum(end - start, 1), 0.0)
    return TrajectoryRecord(stamp_ns, MAP_FRAME, stamps_ns, blend(T_before, T_after, fraction))


def known_covariances(graph: FactorGraph, counters: Counter[str]) -> tuple[FloatArray, FloatArray]:
    """Covariances of keyframes (K, 6, 6) and landmarks (L, 3, 3) m^2 of a graph; a map is worth having without them:
    then there are none.
    """
    try:
        return graph.covariances()
    except FactorGraphError as error:
        logger.warning("the map has local covariances only: %s", error)
        counters["covariances_missing"] = len(graph.landmarks)
        return np.zeros((0, 6, 6)), np.zeros((0, 3, 3))


def place_landmarks(
    object_map: ObjectMap,
    graph: FactorGraph,
    covariances: FloatArray,
    keyframes: Sequence[Keyframe],
    T_map_body: FloatArray,
    first_segment: int,
) -> None:
    """Bring the object map to the final estimate.

    What never got into the graph has no place in the map but where the odometry put it when it was last seen;
    landmarks of a prior map, on segments before ``first_segment``, stay where they were. ``keyframes`` and their
    ``T_map_body`` (K, 4, 4) are those of this drive. ``covariances`` (L, 3, 3) m^2 of landmarks in the graph; without
    them stands what is known relative to the robot.
    """
    landmarks = object_map.rows
    own = np.flatnonzero(landmarks["segment"] >= first_segment)
    T_local_body = np.stack([keyframe.T_local_body for keyframe in keyframes])
    keyframe_stamps_ns = [keyframe.odometry.stamp_ns for keyframe in keyframes]
    last = np.searchsorted(keyframe_stamps_ns, landmarks["last_seen_ns"][own], side="right") - 1
    T_map_local = (T_map_body @ invert(T_local_body))[np.maximum(last, 0)]
    R, positions = T_map_local[:, :3, :3], apply_each(T_map_local, landmarks["position_local"][own])
    around = R @ landmarks["covariance_local"][own] @ np.swapaxes(R, 1, 2)
    object_map.assign(own, position_map=positions, covariance_map=around)
    in_graph = graph.landmarks
    object_map.assign(in_graph, position_map=graph.landmark_positions(in_graph))
    if len(covariances):
        object_map.assign(in_graph, covariance_map=covariances)
