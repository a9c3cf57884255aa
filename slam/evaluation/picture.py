"""What a map looks like, from the records of a log and their evaluation."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slam.evaluation.closure_verdicts import JudgedClosures
from slam.evaluation.closures import ClosureQuality
from slam.evaluation.evaluation import Evaluation
from slam.evaluation.landmarks import CONFIRMED
from slam.evaluation.records import EvaluationRecords
from slam.evaluation.synchronization import PoseSeries, clean_poses
from slam.geometry import FloatArray, IntArray, apply, interpolate, invert
from slam.pictures import MapPicture


def compose_picture(records: EvaluationRecords, evaluation: Evaluation, *, title: str = "Object map") -> MapPicture:
    """Bring all into the map frame: odometry by its first pose, truth by the alignment of the estimate.

    The estimate is the final trajectory, or the poses as they were at their time where a run did not finish. Truth that
    could not be aligned is left out. A closure joins the estimated positions of its two keyframes.
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
        title=title,
        ate_m=errors.absolute.rmse_m if errors else None,
        odometry_ate_m=evaluation.odometry.absolute.rmse_m if evaluation.odometry else None,
        **_closures(evaluation.closures, clean_poses(stamps_ns, poses)),
    )


def _odometry_in_map(records: EvaluationRecords, stamps_ns: IntArray, poses: FloatArray) -> FloatArray:
    T_odom_body = np.array([r.T_odom_body for r in records.odometry]).reshape(-1, 4, 4)
    if len(T_odom_body) == 0 or len(poses) == 0:
        return T_odom_body[:, :3, 3]
    first = int(np.argmin(np.abs(np.array([r.stamp_ns for r in records.odometry]) - stamps_ns[0])))
    return apply(poses[0] @ invert(T_odom_body[first]), T_odom_body[:, :3, 3])


def _closures(quality: ClosureQuality | None, path: PoseSeries) -> dict[str, FloatArray]:
    """Ends of the accepted closures by their verdict, and missed revisits, as :class:`MapPicture` takes them."""
    if quality is None:
        return {}
    judged = quality.judged
    kinds = {
        "true_closures": judged.accepted & judged.true,
        "false_closures": judged.accepted & judged.decided & ~judged.true,
        "closures": judged.accepted & ~judged.decided,
    }
    ends = {name: _find_ends(judged, np.flatnonzero(wanted), path) for name, wanted in kinds.items()}
    missed_ns = quality.revisits.missed_stamps_ns if quality.revisits else np.zeros(0, dtype=np.int64)
    return {**ends, "missed_revisits": _positions_at(path, missed_ns[_is_inside(path, missed_ns)])}


def _find_ends(judged: JudgedClosures, rows: IntArray, path: PoseSeries) -> FloatArray:
    """Estimated positions (C, 2, 3), metres, map frame, of the query and reference keyframes that the path reaches."""
    query_ns, reference_ns = judged.query_stamps_ns[rows], judged.reference_stamps_ns[rows]
    inside = _is_inside(path, query_ns) & _is_inside(path, reference_ns)
    return np.stack([_positions_at(path, query_ns[inside]), _positions_at(path, reference_ns[inside])], axis=1)


def _is_inside(path: PoseSeries, at_ns: IntArray) -> NDArray[np.bool_]:
    if len(path.stamps_ns) == 0:
        return np.zeros(len(at_ns), dtype=np.bool_)
    inside: NDArray[np.bool_] = (at_ns >= path.stamps_ns[0]) & (at_ns <= path.stamps_ns[-1])
    return inside


def _positions_at(path: PoseSeries, at_ns: IntArray) -> FloatArray:
    if len(at_ns) == 0:
        return np.zeros((0, 3))
    return interpolate(path.stamps_ns, path.T_world_body, at_ns)[:, :3, 3]
