"""Which errors of a map are set against which covariances."""

from __future__ import annotations

import numpy as np

from logs.messages import FactorGraphRecord, ObjectMapRecord
from slam.common.arrays import FloatArray
from slam.common.geometry import apply, invert
from slam.evaluation.inputs.protocol import Protocol
from slam.evaluation.inputs.synchronization import PoseSeries
from slam.evaluation.metrics.calibration import (
    IN_PLANE,
    CalibrationQuality,
    Consistency,
    measure_consistency,
    measure_part,
    pose_errors,
    tie,
)
from slam.evaluation.metrics.landmarks import LandmarkMatches
from slam.evaluation.place_recognition.closure_labels import JudgedClosures
from slam.evaluation.place_recognition.revisits import find_true_poses

Pair = tuple[Consistency | None, Consistency | None]
"""In all dimensions and in the plane."""
NOTHING: Pair = (None, None)


def evaluate_calibration(
    graph: FactorGraphRecord | None,
    map_est: ObjectMapRecord | None,
    map_gt: ObjectMapRecord | None,
    matches: LandmarkMatches | None,
    judged: JudgedClosures | None,
    truth: PoseSeries,
    protocol: Protocol,
) -> tuple[CalibrationQuality | None, str]:
    """NEES of keyframes, landmarks and closures, None where there is none of any, and why parts of it are missing.

    The covariances are those in the map frame, which its first keyframe fixes. So the truth is tied there: no other
    alignment, which would fit the errors away, is made.

    Args:
        graph: with the covariances of its poses.
        map_est: the final map.
        map_gt: true objects.
        matches: of confirmed landmarks with true objects, by the truth of their detections.
        judged: closures with their errors.
        truth: may hold no pose.
        protocol: the thresholds.
    """
    missing: list[str] = []
    T_world_map = _tie_first(graph, truth, protocol)
    pose = landmark = closure = NOTHING
    if graph is None or T_world_map is None:
        missing.append("poses and landmarks: no truth at the first keyframe, which fixes the map")
    else:
        pose = _poses(graph, T_world_map, truth, protocol)
        if pose[0] is None:
            missing.append("poses: no covariances of keyframes with truth in the log (/slam/graph)")
        landmark = _landmarks(map_est, map_gt, matches, T_world_map)
        if landmark[0] is None:
            missing.append("landmarks: no confirmed one with a covariance, of an object, by the truth of detections")
    if judged is not None:
        closure = _closures(judged, truth, protocol)
    if closure[0] is None:
        missing.append("closures: no accepted true one with a covariance")
    is_known = any(part is not None for part in (pose[0], landmark[0], closure[0]))
    quality = CalibrationQuality(protocol.coverage_probability, *pose, *landmark, *closure) if is_known else None
    return quality, "; ".join(missing)


def _tie_first(graph: FactorGraphRecord | None, truth: PoseSeries, protocol: Protocol) -> FloatArray | None:
    """``T_world_map`` by the first keyframe; None where it has no truth."""
    if graph is None or len(graph.keyframe_ids) == 0:
        return None
    known, T_world_body = find_true_poses(truth, graph.keyframe_stamps_ns[:1], max_gap_s=protocol.max_truth_gap_s)
    return tie(graph.T_map_body[0], T_world_body[0]) if known[0] else None


def _poses(graph: FactorGraphRecord, T_world_map: FloatArray, truth: PoseSeries, protocol: Protocol) -> Pair:
    if len(graph.pose_covariances) == 0:
        return NOTHING
    known, T_world_body = find_true_poses(truth, graph.keyframe_stamps_ns, max_gap_s=protocol.max_truth_gap_s)
    known[0] = False
    errors = pose_errors(graph.T_map_body[known], invert(T_world_map) @ T_world_body[known])
    return _both(errors, graph.pose_covariances[known])


def _landmarks(
    map_est: ObjectMapRecord | None,
    map_gt: ObjectMapRecord | None,
    matches: LandmarkMatches | None,
    T_world_map: FloatArray,
) -> Pair:
    if map_est is None or map_gt is None or matches is None:
        return NOTHING
    matched = matches.object_rows >= 0
    rows = matches.landmark_rows[matched]
    errors = map_est.positions[rows] - apply(invert(T_world_map), map_gt.positions[matches.object_rows[matched]])
    covariances = map_est.covariances[rows]
    return measure_consistency(errors, covariances), measure_part(errors, covariances, (0, 1))


def _closures(judged: JudgedClosures, truth: PoseSeries, protocol: Protocol) -> Pair:
    rows = [
        row
        for row in np.flatnonzero(judged.accepted & judged.true).tolist()
        if judged.candidates[row].covariance is not None
    ]
    if not rows:
        return NOTHING
    both_ns = np.stack([judged.reference_stamps_ns[rows], judged.query_stamps_ns[rows]])
    _, poses = find_true_poses(truth, both_ns.ravel(), max_gap_s=protocol.max_truth_gap_s)
    T_world_reference, T_world_query = poses[: len(rows)], poses[len(rows) :]
    T_reference_query = np.array([judged.candidates[row].T_reference_query for row in rows])
    covariances = np.array([judged.candidates[row].covariance for row in rows])
    return _both(pose_errors(T_reference_query, invert(T_world_reference) @ T_world_query), covariances)


def _both(errors: FloatArray, covariances: FloatArray) -> Pair:
    return measure_consistency(errors, covariances), measure_part(errors, covariances, IN_PLANE)
