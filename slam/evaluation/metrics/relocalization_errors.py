"""Errors of fixes, the poses at which a lost robot was relocalized."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from logs.messages import LoopClosureRecord
from slam.common.arrays import FloatArray
from slam.common.geometry import invert, rotation_angle_rad
from slam.evaluation.inputs.protocol import Protocol
from slam.evaluation.inputs.synchronization import PoseSeries
from slam.evaluation.place_recognition.closures import judge_closures
from slam.evaluation.place_recognition.revisits import find_true_poses

Span = tuple[int, int | None]
"""Stamps [ns] at which a robot was lost, and at which it knew again where it is; None if it never did."""
FixError = tuple[float, float] | None
"""Metres, and degrees of the whole angle of rotation, of a fix; None where there is none or no truth of it."""


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
    judged = judge_closures([each for each in made if each is not None], {}, truth, protocol)
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
    """Errors of the first pose at or after each fix, transformed by ``T_world_map`` (4, 4); without it there are none.

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
