"""Estimate, odometry, truth and closures of an evaluation, brought into one frame: the map."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from logs.messages import FactorGraphRecord
from slam.common.arrays import FloatArray, IntArray
from slam.common.geometry import apply, interpolate, invert
from slam.evaluation.inputs.records import EvaluationRecords
from slam.evaluation.inputs.synchronization import PoseSeries, clean_poses
from slam.evaluation.place_recognition.closure_labels import JudgedClosures
from slam.evaluation.result import Evaluation

_USUAL_SHARE, _LEAP_STEPS = 0.9, 10.0
"""A leap is that many times as long as that share of all steps with motion."""
_LEAP_SHARE = 0.02
"""And that long, in parts of the extent of the path: shorter ones are not seen."""


@dataclass(frozen=True, slots=True, eq=False)
class MapPaths:
    """Paths in the map frame, metres; each may be empty.

    ``estimate`` is the final trajectory, or the poses as they were at their time where a run did not finish.
    odometry, truth (N, 3): positions along the path. estimate_jumps, odometry_jumps, truth_jumps: rows before a
    discontinuity of the odometry or a step that no robot makes, after which the path goes on elsewhere. lost, found
    (J, 3): where the robot lost and found its place.
    """

    estimate: PoseSeries
    odometry: FloatArray
    truth: FloatArray
    estimate_jumps: IntArray
    odometry_jumps: IntArray
    truth_jumps: IntArray
    lost: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    found: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))

    def positions_at(self, at_ns: IntArray) -> FloatArray:
        """Estimated positions (M, 3), metres, map frame, at any times (M,); NaN where the path does not reach."""
        return self.poses_at(at_ns)[:, :3, 3]

    def poses_at(self, at_ns: IntArray) -> FloatArray:
        """``T_map_body`` (M, 4, 4), as :meth:`positions_at`."""
        poses = np.full((len(at_ns), 4, 4), np.nan)
        stamps_ns = self.estimate.stamps_ns
        if len(stamps_ns):
            inside = (at_ns >= stamps_ns[0]) & (at_ns <= stamps_ns[-1])
            poses[inside] = interpolate(stamps_ns, self.estimate.T_world_body, at_ns[inside])
        return poses

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
    odometry = _odometry_in_map(records, estimate)
    odometry_ns = np.array([r.stamp_ns for r in records.odometry], dtype=np.int64)
    spans_ns = _discontinuities(records.graph)
    paths = MapPaths(
        estimate=estimate,
        odometry=odometry,
        truth=apply(invert(errors.alignment.T_world_map), truth) if errors else np.zeros((0, 3)),
        estimate_jumps=_jumps(estimate.stamps_ns, estimate.positions, spans_ns),
        odometry_jumps=_jumps(odometry_ns, odometry, spans_ns),
        truth_jumps=_leaps(truth) if errors else np.zeros(0, dtype=np.int64),
    )
    losses = evaluation.relocalization.losses if evaluation.relocalization else ()
    lost_ns = np.array([loss.lost_ns for loss in losses], dtype=np.int64)
    found_ns = np.array([loss.fix_ns for loss in losses if loss.fix_ns is not None], dtype=np.int64)
    lost, found = paths.positions_at(lost_ns), paths.positions_at(found_ns)
    return replace(paths, lost=lost[np.isfinite(lost).all(axis=1)], found=found[np.isfinite(found).all(axis=1)])


def _discontinuities(graph: FactorGraphRecord | None) -> IntArray:
    """Stamps (J, 2) of the keyframes before and after each discontinuity of the odometry."""
    if graph is None:
        return np.zeros((0, 2), dtype=np.int64)
    stamp_of = dict(zip(graph.keyframe_ids.tolist(), graph.keyframe_stamps_ns.tolist(), strict=True))
    ends = [
        (stamp_of[first], stamp_of[second])
        for (first, second), kind in zip(graph.edge_keyframe_ids.tolist(), graph.edge_kinds, strict=True)
        if kind == "discontinuity"
    ]
    return np.array(sorted(ends), dtype=np.int64).reshape(-1, 2)


def _jumps(stamps_ns: IntArray, positions: FloatArray, spans_ns: IntArray) -> IntArray:
    """Rows before the longest step of a path (N, 3) within each span (J, 2), and before each leap."""
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    rows = []
    for first_ns, last_ns in spans_ns:
        begin = max(int(np.searchsorted(stamps_ns, first_ns, side="right")) - 1, 0)
        within = steps[begin : np.searchsorted(stamps_ns, last_ns)]
        if len(within) and first_ns < last_ns:
            rows.append(begin + int(np.argmax(within)))
    return np.union1d(np.array(rows, dtype=np.int64), _leaps(positions))


def _leaps(positions: FloatArray) -> IntArray:
    """Rows before steps of a path (N, 3) that are far longer than the others, and long on the map."""
    steps_m = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    moving_m = steps_m[steps_m > 0.0]
    if not len(moving_m):
        return np.zeros(0, dtype=np.int64)
    extent_m = float(np.linalg.norm(np.ptp(positions, axis=0)))
    usual_m = float(np.quantile(moving_m, _USUAL_SHARE))
    return np.flatnonzero(steps_m > max(_LEAP_STEPS * usual_m, _LEAP_SHARE * extent_m))


def _odometry_in_map(records: EvaluationRecords, estimate: PoseSeries) -> FloatArray:
    T_odom_body = np.array([r.T_odom_body for r in records.odometry]).reshape(-1, 4, 4)
    if len(T_odom_body) == 0 or len(estimate.stamps_ns) == 0:
        return T_odom_body[:, :3, 3]
    first = int(np.argmin(np.abs(np.array([r.stamp_ns for r in records.odometry]) - estimate.stamps_ns[0])))
    return apply(estimate.T_world_body[0] @ invert(T_odom_body[first]), T_odom_body[:, :3, 3])
