"""Time and errors of relocalizations."""

from collections.abc import Iterable
from itertools import groupby
from typing import Any

import numpy as np

from logs.messages import StatusRecord
from slam.common.arrays import FloatArray
from slam.common.errors import EvaluationError
from slam.common.geometry import invert, rotation_angle_rad
from slam.evaluation.inputs.protocol import Protocol
from slam.evaluation.inputs.records import EvaluationRecords
from slam.evaluation.inputs.synchronization import PoseSeries
from slam.evaluation.metrics.statistics import fraction, percentile
from slam.localization.state import State

MEASURES = ("seconds", "distance_m", "error_m", "error_deg")
Span = tuple[int, int | None]
"""Stamps [ns] at which a robot was lost, and at which it knew again where it is; None if it never did."""
PlacedPose = tuple[int, FloatArray]
"""A stamp [ns], and where the robot is in the world by a fix (4, 4)."""


def evaluate_relocalization(
    records: EvaluationRecords, protocol: Protocol, map_alignment: FloatArray | None, T_world_map: FloatArray | None
) -> dict[str, Any]:
    """Counts, shares and medians over all fixes, right or wrong, and each loss by itself, by the keys of the JSON.

    The shares are of the losses that are not undecided; None where there is none.

    * A loss begins with the first status in state LOST, also at the start of the drive, and ends with RELOCALIZED.
    * ``method`` "closure": the error of a fix is that of the accepted closure that made it, the last one up to its
      stamp whose reference is from before the loss. In a given map, "map", "trajectory": that of the first pose on
      ``/slam/pose`` at or after its stamp, laid on the truth by the alignment of the map, or else of the trajectory.
    * A fix is right within ``closure_translation_m`` and ``closure_rotation_deg``, both inclusive.

    Args:
        records: of the drive.
        protocol: the thresholds.
        map_alignment: ``T_world_map`` (4, 4) of the given map.
        T_world_map: (4, 4) of the trajectory; without either all fixes in a given map are undecided.

    Raises:
        EvaluationError: there is no status.
    """
    if not records.statuses:
        raise EvaluationError("no status in the log (/slam/status)")
    method = "closure" if not records.has_prior_map else "trajectory" if map_alignment is None else "map"
    T_world_map = T_world_map if map_alignment is None else map_alignment
    losses = [_describe_loss(records, span, protocol, T_world_map) for span in find_losses(records.statuses)]
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
        "method": method,
        "losses": losses,
    }


def find_losses(statuses: Iterable[StatusRecord]) -> list[Span]:
    """Stamps (lost, fix) of all losses; the last one may have no fix."""
    losses: list[Span] = []
    for is_lost, alike in groupby(statuses, lambda status: status.state == State.LOST):
        since_ns = next(alike).stamp_ns
        if is_lost:
            losses.append((since_ns, None))
        elif losses:
            losses[-1] = losses[-1][0], since_ns
    return losses


def _describe_loss(
    records: EvaluationRecords, span: Span, protocol: Protocol, T_world_map: FloatArray | None
) -> dict[str, Any]:
    """The outcome of a loss; figures that need a fix or a truth are None without it."""
    lost_ns, fix_ns = span
    loss: dict[str, Any] = {"lost_ns": lost_ns, "fix_ns": fix_ns, **dict.fromkeys((*MEASURES, "is_right"))}
    if fix_ns is None:
        return loss
    loss |= {"seconds": (fix_ns - lost_ns) * 1e-9, "distance_m": _travel_m(records, lost_ns, fix_ns)}
    placed = (
        _place_by_pose(records.online_path, fix_ns, T_world_map)
        if records.has_prior_map
        else _place_by_closure(records, lost_ns, fix_ns)
    )
    if placed is None:
        return loss
    stamp_ns, T_world_body = placed
    T_error = invert(records.true_path.poses_at(np.array([stamp_ns]))[0]) @ T_world_body
    error_m, turn_rad = np.asarray(np.linalg.norm(T_error[:3, 3])), rotation_angle_rad(T_error)
    if not np.isnan(error_m):
        is_right = bool(protocol.is_true(error_m, turn_rad))
        loss |= {"error_m": float(error_m), "error_deg": np.rad2deg(turn_rad), "is_right": is_right}
    return loss


def _travel_m(records: EvaluationRecords, from_ns: int, to_ns: int) -> float | None:
    """Along the truth where it spans the time, else along the odometry, which may jump on the way."""
    for path in (records.true_path, records.odometry_path):
        if path and path.stamps_ns[0] <= from_ns and to_ns <= path.stamps_ns[-1]:
            return float(np.ptp(path.travelled_at_m(np.array([from_ns, to_ns]))))
    return None


def _place_by_closure(records: EvaluationRecords, lost_ns: int, fix_ns: int) -> PlacedPose | None:
    """Where the closure across the break that ended a loss puts its query keyframe in the world, at its stamp."""
    across = [
        c for c in records.closures if c.accepted and lost_ns <= c.stamp_ns <= fix_ns and c.reference_stamp_ns < lost_ns
    ]
    made = max(across, key=lambda c: c.stamp_ns, default=None)
    if made is None or made.T_reference_query is None:
        return None
    T_world_reference = records.true_path.poses_at(np.array([made.reference_stamp_ns]))[0]
    return made.stamp_ns, T_world_reference @ made.T_reference_query


def _place_by_pose(poses: PoseSeries, fix_ns: int, T_world_map: FloatArray | None) -> PlacedPose | None:
    """The first pose at or after a fix, in the world, and its stamp."""
    row = np.searchsorted(poses.stamps_ns, fix_ns)
    if T_world_map is None or row == len(poses):
        return None
    return int(poses.stamps_ns[row]), T_world_map @ poses.T_world_body[row]
