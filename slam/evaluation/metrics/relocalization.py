"""Time and errors of relocalizations."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, Literal

import numpy as np

from logs.messages import LoopClosureRecord, StatusRecord
from slam.common.arrays import FloatArray
from slam.common.errors import EvaluationError
from slam.common.geometry import invert, rotation_angle_rad
from slam.evaluation.inputs.protocol import Protocol
from slam.evaluation.inputs.records import EvaluationRecords
from slam.evaluation.inputs.synchronization import PoseSeries, synchronize
from slam.evaluation.metrics.alignment import align_path
from slam.evaluation.metrics.statistics import fraction, percentile
from slam.evaluation.place_recognition.closures import judge_closures
from slam.evaluation.place_recognition.revisits import find_true_poses

LOST = "LOST"
MEASURES = ("seconds", "distance_m", "error_m", "error_deg")
Method = Literal["closure", "map", "trajectory"]
Span = tuple[int, int | None]
"""Stamps [ns] at which a robot was lost, and at which it knew again where it is; None if it never did."""
FixError = tuple[float, float] | None
"""Position error [m] and rotation error [deg] of a fix; None without a fix, or without a true pose at its time."""


def locate_map(mapping: EvaluationRecords) -> FloatArray:
    """``T_world_map`` (4, 4) of a map, from the drive that made it: its final trajectory laid on its truth.

    Args:
        mapping: records of the output log of the drive that saved the map.

    Raises:
        EvaluationError: that log has no final trajectory or no truth, or the two cannot be aligned.
    """
    if mapping.trajectory is None or not mapping.true_poses:
        lacks = "final trajectory" if mapping.trajectory is None else "ground truth"
        raise EvaluationError(f"the log of the drive that made the map has no {lacks}, so the map cannot be located")
    poses = synchronize(mapping.final_path, mapping.true_path, max_gap_s=Protocol().max_truth_gap_s)
    return align_path(poses.positions_est, poses.positions_gt).T_world_map


def evaluate_relocalization(
    records: EvaluationRecords,
    truth: PoseSeries,
    odometry: PoseSeries,
    protocol: Protocol,
    *,
    T_world_map: FloatArray | None = None,
    method: Method = "closure",
) -> dict[str, Any]:
    """Counts, shares and medians over all fixes, right or wrong, and each loss by itself, by the keys of the JSON.

    The shares are of the losses that are not undecided; None where there is none.

    * A loss begins with the first status in state LOST, also at the start of the drive, and ends with RELOCALIZED.
    * ``method`` "closure": the error of a fix is that of the accepted closure that made it, the last one up to its
      stamp whose reference is from before the loss. "map", "trajectory": that of the first pose on ``/slam/pose`` at or
      after its stamp, laid on the truth by ``T_world_map``.
    * A fix is right within ``closure_translation_m`` and ``closure_rotation_deg``, both inclusive.

    Args:
        records: statuses, poses and closures of the drive.
        truth: may hold no pose.
        odometry: may hold no pose.
        protocol: the thresholds.
        T_world_map: (4, 4); without it "map" and "trajectory" leave all fixes undecided.
        method: how the error is measured.
    """
    spans = find_losses(records.statuses)
    if method == "closure":
        errors = measure_by_closures(records.closures, spans, truth, protocol)
    else:
        errors = measure_by_poses(records.online_path, spans, truth, T_world_map, protocol)
    losses = [_describe_loss(span, error, truth, odometry, protocol) for span, error in zip(spans, errors, strict=True)]
    fixes = [loss for loss in losses if loss["fix_ns"] is not None]
    right, wrong = (sum(loss["is_right"] is answer for loss in losses) for answer in (True, False))
    undecided = len(fixes) - right - wrong
    return {
        "loss_count": len(losses),
        "fix_count": len(fixes),
        "right_count": right,
        "wrong_count": wrong,
        "undecided_count": undecided,
        "success_rate": fraction(right, len(losses) - undecided),
        "false_relocalization_rate": fraction(wrong, len(losses) - undecided),
        **{f"median_{name}": percentile([fix[name] for fix in fixes], 50.0) for name in MEASURES},
        "lost_time_ratio": _share_lost(records, spans),
        "method": method,
        "losses": losses,
    }


def find_losses(statuses: Iterable[StatusRecord]) -> list[Span]:
    """Stamps (lost, fix) of all losses; the last one may have no fix."""
    losses: list[Span] = []
    is_lost = False
    for status in statuses:
        if status.state == LOST and not is_lost:
            losses.append((status.stamp_ns, None))
            is_lost = True
        elif status.state != LOST and is_lost:
            losses[-1] = losses[-1][0], status.stamp_ns
            is_lost = False
    return losses


def _describe_loss(
    span: Span, error: FixError, truth: PoseSeries, odometry: PoseSeries, protocol: Protocol
) -> dict[str, Any]:
    """The outcome of a loss; figures that need a fix or a truth are None without it."""
    lost_ns, fix_ns = span
    error_m, error_deg = error or (None, None)
    is_right = None
    if error_m is not None and error_deg is not None:
        is_near = error_m <= protocol.closure_translation_m
        is_right = is_near and error_deg <= protocol.closure_rotation_deg
    return {
        "lost_ns": lost_ns,
        "fix_ns": fix_ns,
        "seconds": None if fix_ns is None else (fix_ns - lost_ns) * 1e-9,
        "distance_m": None if fix_ns is None else _travel_m(lost_ns, fix_ns, truth, odometry),
        "error_m": error_m,
        "error_deg": error_deg,
        "is_right": is_right,
    }


def _travel_m(from_ns: int, to_ns: int, truth: PoseSeries, odometry: PoseSeries) -> float | None:
    """Along the truth where it spans the time, else along the odometry, which may jump on the way."""
    for path in (truth, odometry):
        if len(path.stamps_ns) and path.stamps_ns[0] <= from_ns and to_ns <= path.stamps_ns[-1]:
            return float(np.diff(path.travelled_at_m(np.array([from_ns, to_ns], dtype=np.int64)))[0])
    return None


def _share_lost(records: EvaluationRecords, spans: Sequence[Span]) -> float | None:
    stamps = [
        *(each.stamp_ns for each in records.odometry),
        *(each.stamp_ns for each in records.online_poses),
        *(each.stamp_ns for each in records.statuses),
    ]
    first_ns, last_ns = min(stamps, default=0), max(stamps, default=0)
    lost_ns = sum((last_ns if fix_ns is None else fix_ns) - from_ns for from_ns, fix_ns in spans)
    return lost_ns / (last_ns - first_ns) if last_ns > first_ns else None


def measure_by_closures(
    closures: Sequence[LoopClosureRecord], spans: Sequence[Span], truth: PoseSeries, protocol: Protocol
) -> list[FixError]:
    """Errors of the closure of each fix: the last accepted one up to its stamp with a reference from before the loss.

    Args:
        closures: all records, in the order of the log.
        spans: losses and fixes.
        truth: may hold no pose.
        protocol: the thresholds.
    """
    made = [_find_closure(closures, *span) for span in spans]
    judged = judge_closures([each for each in made if each is not None], truth, protocol)
    errors = zip(judged["error_m"], np.rad2deg(judged["rotation_rad"]), judged["decided"], strict=True)
    found = iter((float(m), float(deg)) if decided else None for m, deg, decided in errors)
    return [None if each is None else next(found) for each in made]


def _find_closure(closures: Sequence[LoopClosureRecord], lost_ns: int, fix_ns: int | None) -> LoopClosureRecord | None:
    """The closure across the break that ended a loss."""
    across = [
        c
        for c in closures
        if fix_ns is not None and c.accepted and lost_ns <= c.stamp_ns <= fix_ns and c.reference_stamp_ns < lost_ns
    ]
    return max(across, key=lambda c: c.stamp_ns, default=None)


def measure_by_poses(
    poses: PoseSeries,
    spans: Sequence[Span],
    truth: PoseSeries,
    T_world_map: FloatArray | None,
    protocol: Protocol,
) -> list[FixError]:
    """Errors of the first pose at or after each fix, transformed by ``T_world_map`` (4, 4); None for all without it.

    Args:
        poses: as they were at their time.
        spans: losses and fixes.
        truth: may hold no pose.
        T_world_map: where the truth has the map.
        protocol: the thresholds.
    """
    errors: list[FixError] = [None] * len(spans)
    if T_world_map is None or not len(poses):
        return errors
    fixed = [k for k, (_, fix_ns) in enumerate(spans) if fix_ns is not None and fix_ns <= poses.stamps_ns[-1]]
    rows = np.searchsorted(poses.stamps_ns, np.array([spans[k][1] for k in fixed], dtype=np.int64))
    known, T_world_body_gt = find_true_poses(truth, poses.stamps_ns[rows], max_gap_s=protocol.max_truth_gap_s)
    T_world_body_est = T_world_map @ poses.T_world_body[rows]
    errors_m = np.linalg.norm(T_world_body_est[:, :3, 3] - T_world_body_gt[:, :3, 3], axis=1)
    errors_deg = np.rad2deg(rotation_angle_rad(invert(T_world_body_gt) @ T_world_body_est))
    for k, error_m, error_deg, comparable in zip(fixed, errors_m, errors_deg, known, strict=True):
        errors[k] = (float(error_m), float(error_deg)) if comparable else None
    return errors
