"""How soon a robot that was lost knows where it is, and whether it is right."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from logs.messages import StatusRecord
from slam.common.arrays import FloatArray
from slam.common.errors import EvaluationError
from slam.evaluation.inputs.protocol import Protocol
from slam.evaluation.inputs.records import EvaluationRecords
from slam.evaluation.inputs.synchronization import PoseSeries, synchronize
from slam.evaluation.metrics.alignment import align_path
from slam.evaluation.metrics.relocalization_errors import FixError, Span, measure_by_closures, measure_by_poses

LOST = "LOST"
Method = Literal["closure", "map", "trajectory"]
PERCENTILES = {
    "median_seconds": ("seconds", 50.0),
    "max_seconds": ("seconds", 100.0),
    "median_distance_m": ("distance_m", 50.0),
    "max_distance_m": ("distance_m", 100.0),
    "median_error_m": ("error_m", 50.0),
    "p95_error_m": ("error_m", 95.0),
    "median_error_deg": ("error_deg", 50.0),
    "p95_error_deg": ("error_deg", 95.0),
}
"""Figure -> column of :class:`Loss`, and percentile."""


@dataclass(frozen=True, slots=True)
class Loss:
    """From the stamp at which the robot was lost to the one at which it said that it knows where it is.

    ``fix_ns``, ``seconds``, ``distance_m``: None where it never did; errors and ``is_right`` also where there is no
    truth to compare with.
    """

    lost_ns: int
    fix_ns: int | None = None
    seconds: float | None = None
    distance_m: float | None = None
    error_m: float | None = None
    error_deg: float | None = None
    is_right: bool | None = None


@dataclass(frozen=True, slots=True)
class RelocalizationQuality:
    """All losses of a drive in the order of time, and the share of the drive that was spent lost.

    ``method``: how the error of a fix was measured, by the closure that made it, by where the truth has the given map,
    or by the alignment of this drive's own trajectory.
    """

    losses: tuple[Loss, ...]
    lost_time_ratio: float | None
    method: Method

    @property
    def loss_count(self) -> int:
        """How often the robot was lost."""
        return len(self.losses)

    @property
    def fix_count(self) -> int:
        """Losses that ended within the drive, rightly or wrongly."""
        return sum(loss.fix_ns is not None for loss in self.losses)

    @property
    def right_count(self) -> int:
        """Fixes that are right."""
        return sum(loss.is_right is True for loss in self.losses)

    @property
    def wrong_count(self) -> int:
        """Fixes that are wrong."""
        return sum(loss.is_right is False for loss in self.losses)

    @property
    def undecided_count(self) -> int:
        """Fixes of which the truth says nothing."""
        return self.fix_count - self.right_count - self.wrong_count

    @property
    def success_rate(self) -> float | None:
        """Losses with a right fix among those that were not undecided; None where there is none."""
        return self._rate(self.right_count)

    @property
    def false_relocalization_rate(self) -> float | None:
        """Losses with a wrong fix among those that were not undecided; None where there is none."""
        return self._rate(self.wrong_count)

    def percentiles(self) -> dict[str, float | None]:
        """Figures of all fixes, right or wrong, by the names of :data:`PERCENTILES`; None where no fix has them."""
        figures: dict[str, float | None] = {}
        for name, (column, percent) in PERCENTILES.items():
            known = [value for loss in self.losses if (value := getattr(loss, column)) is not None]
            figures[name] = float(np.percentile(known, percent)) if known else None
        return figures

    def _rate(self, count: int) -> float | None:
        decided = self.loss_count - self.undecided_count
        return count / decided if decided else None


def locate_map(mapping: EvaluationRecords, protocol: Protocol | None = None) -> FloatArray:
    """``T_world_map`` (4, 4) of a map, from the drive that made it: its final trajectory laid on its truth.

    Args:
        mapping: records of the output log of the drive that saved the map.
        protocol: the thresholds.

    Raises:
        EvaluationError: that log has no final trajectory or no truth, or the two cannot be aligned.
    """
    if mapping.trajectory is None or not mapping.true_poses:
        lacks = "final trajectory" if mapping.trajectory is None else "ground truth"
        raise EvaluationError(f"the log of the drive that made the map has no {lacks}, so the map cannot be located")
    max_gap_s = (protocol or Protocol()).max_truth_gap_s
    poses = synchronize(mapping.final_path, mapping.true_path, max_gap_s=max_gap_s)
    return align_path(poses.positions_est, poses.positions_gt).T_world_map


def evaluate_relocalization(
    records: EvaluationRecords,
    truth: PoseSeries,
    odometry: PoseSeries,
    protocol: Protocol,
    *,
    T_world_map: FloatArray | None = None,
    method: Method = "closure",
) -> RelocalizationQuality:
    """Times, distances and errors of all losses of a drive.

    * A loss begins with the first status in state LOST, also at the start of the drive, and ends with RELOCALIZED.
    * ``method`` "closure": the error of a fix is that of the accepted closure that made it, the last one up to its
      stamp whose reference is from before the loss. "map", "trajectory": that of the first pose on ``/slam/pose`` at or
      after its stamp, laid on the truth by ``T_world_map``.
    * A fix is right within ``relocalization_translation_m`` and ``relocalization_rotation_deg``, both inclusive.

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
    losses = tuple(
        _describe_loss(span, error, truth, odometry, protocol) for span, error in zip(spans, errors, strict=True)
    )
    return RelocalizationQuality(losses, _share_lost(records, spans), method)


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


def _describe_loss(span: Span, error: FixError, truth: PoseSeries, odometry: PoseSeries, protocol: Protocol) -> Loss:
    lost_ns, fix_ns = span
    if fix_ns is None:
        return Loss(lost_ns)
    seconds, distance_m = (fix_ns - lost_ns) * 1e-9, _travel_m(lost_ns, fix_ns, truth, odometry)
    if error is None:
        return Loss(lost_ns, fix_ns, seconds, distance_m)
    is_right = error[0] <= protocol.relocalization_translation_m and error[1] <= protocol.relocalization_rotation_deg
    return Loss(lost_ns, fix_ns, seconds, distance_m, *error, is_right)


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
