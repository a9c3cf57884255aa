"""Estimate, odometry, truth and closures of an evaluation, brought into one frame: the map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam.common.arrays import FloatArray, IntArray
from slam.common.geometry import apply, interpolate, invert
from slam.evaluation.inputs.records import EvaluationRecords
from slam.evaluation.inputs.synchronization import PoseSeries, clean_poses
from slam.evaluation.place_recognition.closure_labels import JudgedClosures
from slam.evaluation.result import Evaluation


@dataclass(frozen=True, slots=True, eq=False)
class MapPaths:
    """Paths in the map frame, metres; each may be empty.

    ``estimate`` is the final trajectory, or the poses as they were at their time where a run did not finish.
    odometry, truth (N, 3): positions along the path.
    """

    estimate: PoseSeries
    odometry: FloatArray
    truth: FloatArray

    def positions_at(self, at_ns: IntArray) -> FloatArray:
        """Estimated positions (M, 3), metres, map frame, at any times (M,); NaN where the path does not reach."""
        positions = np.full((len(at_ns), 3), np.nan)
        stamps_ns = self.estimate.stamps_ns
        if len(stamps_ns):
            inside = (at_ns >= stamps_ns[0]) & (at_ns <= stamps_ns[-1])
            positions[inside] = interpolate(stamps_ns, self.estimate.T_world_body, at_ns[inside])[:, :3, 3]
        return positions

    def closure_ends(self, judged: JudgedClosures) -> FloatArray:
        """Positions (C, 2, 3) of the query and the reference keyframe of each closure, NaN as :meth:`positions_at`."""
        return np.stack([self.positions_at(judged.query_stamps_ns), self.positions_at(judged.reference_stamps_ns)], 1)


def bring_into_map(records: EvaluationRecords, evaluation: Evaluation) -> MapPaths:
    """Bring the odometry into the map frame by its first pose, the truth by the alignment of the estimate.

    Truth that could not be aligned is left out.
    """
    final = records.trajectory
    stamps_ns = final.stamps_ns if final else np.array([r.stamp_ns for r in records.online_poses], dtype=np.int64)
    poses = final.T_map_body if final else np.array([r.T_map_body for r in records.online_poses]).reshape(-1, 4, 4)
    estimate = clean_poses(stamps_ns, poses)
    errors = evaluation.estimate or evaluation.online
    truth = np.array([r.T_world_body[:3, 3] for r in records.true_poses]).reshape(-1, 3)
    return MapPaths(
        estimate=estimate,
        odometry=_odometry_in_map(records, estimate),
        truth=apply(invert(errors.alignment.T_world_map), truth) if errors else np.zeros((0, 3)),
    )


def _odometry_in_map(records: EvaluationRecords, estimate: PoseSeries) -> FloatArray:
    T_odom_body = np.array([r.T_odom_body for r in records.odometry]).reshape(-1, 4, 4)
    if len(T_odom_body) == 0 or len(estimate.stamps_ns) == 0:
        return T_odom_body[:, :3, 3]
    first = int(np.argmin(np.abs(np.array([r.stamp_ns for r in records.odometry]) - estimate.stamps_ns[0])))
    return apply(estimate.T_world_body[0] @ invert(T_odom_body[first]), T_odom_body[:, :3, 3])
