"""What a map looks like, from the records of a log and their evaluation."""

from __future__ import annotations

import numpy as np

from slam.evaluation.evaluation import Evaluation
from slam.evaluation.landmarks import CONFIRMED
from slam.evaluation.records import EvaluationRecords
from slam.evaluation.synchronization import clean_poses
from slam.geometry import FloatArray, IntArray, apply, interpolate, invert
from slam.pictures import MapPicture


def compose_picture(records: EvaluationRecords, evaluation: Evaluation, *, title: str = "Object map") -> MapPicture:
    """Bring all into the map frame: odometry by its first pose, truth by the alignment of the estimate.

    The estimate is the final trajectory, or the poses as they were at their time where a run did not finish. Truth that
    could not be aligned is left out. A closure joins the estimated positions of the frames that it ties together, which
    needs its registration: the reference keyframe's place follows from the query's.
    """
    final = records.trajectory
    stamps_ns = final.stamps_ns if final else np.array([r.stamp_ns for r in records.online_poses], dtype=np.int64)
    poses = final.T_map_body if final else np.array([r.T_map_body for r in records.online_poses]).reshape(-1, 4, 4)
    errors = evaluation.estimate or evaluation.online
    truth = np.array([r.T_world_body[:3, 3] for r in records.true_poses]).reshape(-1, 3)
    rows: list[int] = []
    if records.object_map is not None:
        rows = [row for row, state in enumerate(records.object_map.states) if state == CONFIRMED]
    return MapPicture(
        estimate=poses[:, :3, 3],
        odometry=_odometry_in_map(records, stamps_ns, poses),
        truth=apply(invert(errors.alignment.T_world_map), truth) if errors else np.zeros((0, 3)),
        landmarks=records.object_map.positions[rows] if records.object_map else np.zeros((0, 3)),
        labels=tuple(records.object_map.labels[row] for row in rows) if records.object_map else (),
        closures=_closures(records, stamps_ns, poses),
        title=title,
        ate_m=errors.absolute.rmse_m if errors else None,
        odometry_ate_m=evaluation.odometry.absolute.rmse_m if evaluation.odometry else None,
    )


def _odometry_in_map(records: EvaluationRecords, stamps_ns: IntArray, poses: FloatArray) -> FloatArray:
    T_odom_body = np.array([r.T_odom_body for r in records.odometry]).reshape(-1, 4, 4)
    if len(T_odom_body) == 0 or len(poses) == 0:
        return T_odom_body[:, :3, 3]
    first = int(np.argmin(np.abs(np.array([r.stamp_ns for r in records.odometry]) - stamps_ns[0])))
    return apply(poses[0] @ invert(T_odom_body[first]), T_odom_body[:, :3, 3])


def _closures(records: EvaluationRecords, stamps_ns: IntArray, poses: FloatArray) -> FloatArray:
    """Ends (C, 2, 3), metres, map frame, of the accepted closures within the trajectory."""
    path = clean_poses(stamps_ns, poses)
    accepted = [
        (closure.stamp_ns, closure.T_reference_query)
        for closure in records.closures
        if closure.accepted
        and closure.T_reference_query is not None
        and len(path.stamps_ns)
        and path.stamps_ns[0] <= closure.stamp_ns <= path.stamps_ns[-1]
    ]
    if not accepted:
        return np.zeros((0, 2, 3))
    at_ns = np.array([stamp for stamp, _ in accepted], dtype=np.int64)
    T_map_query = interpolate(path.stamps_ns, path.T_world_body, at_ns)
    T_map_reference = T_map_query @ invert(np.array([T for _, T in accepted]))
    return np.stack([T_map_query[:, :3, 3], T_map_reference[:, :3, 3]], axis=1)
