"""Synchronization of two series of poses: the truth is interpolated at the stamps of the estimate."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from slam.common.arrays import FloatArray, IntArray
from slam.common.errors import EvaluationError
from slam.common.geometry import interpolate, travelled_m


@dataclass(frozen=True, slots=True, eq=False)
class PoseSeries:
    """Poses of the body in one fixed frame: stamps_ns (N,) strictly increasing, T_world_body (N, 4, 4), N may be 0."""

    stamps_ns: IntArray
    T_world_body: FloatArray

    def __len__(self) -> int:
        return len(self.stamps_ns)

    @property
    def positions(self) -> FloatArray:
        """Positions (N, 3), metres, world frame."""
        return self.T_world_body[:, :3, 3]

    @property
    def travelled_m(self) -> FloatArray:
        """Path length (N,), metres, from the first pose."""
        return travelled_m(self.T_world_body)

    def travelled_at_m(self, at_ns: IntArray) -> FloatArray:
        """Path length (M,), metres, at the times ``at_ns`` (M,): linear in between, held beyond both ends."""
        origin_ns = self.stamps_ns[0]  # Offsets are exact in float64, epoch nanoseconds are not.
        offsets = np.asarray(at_ns, dtype=np.int64) - origin_ns
        known = (self.stamps_ns - origin_ns).astype(np.float64)
        return np.asarray(np.interp(offsets.astype(np.float64), known, self.travelled_m))


@dataclass(frozen=True, slots=True, eq=False)
class SynchronizedPoses:
    """Estimate and truth at the same M stamps: stamps_ns (M,), T_map_body_est and T_world_body_gt (M, 4, 4)."""

    stamps_ns: IntArray
    T_map_body_est: FloatArray
    T_world_body_gt: FloatArray

    @property
    def positions_est(self) -> FloatArray:
        """Estimated positions (M, 3), metres, map frame."""
        return self.T_map_body_est[:, :3, 3]

    @property
    def positions_gt(self) -> FloatArray:
        """True positions (M, 3), metres, world frame."""
        return self.T_world_body_gt[:, :3, 3]


def series_of(stamped_poses: Iterable[tuple[int, FloatArray]]) -> PoseSeries:
    """:func:`clean_poses` of pairs of stamp [ns] and transform (4, 4)."""
    pairs = list(stamped_poses)
    stamps_ns = np.array([stamp_ns for stamp_ns, _ in pairs], dtype=np.int64)
    return clean_poses(stamps_ns, np.array([T for _, T in pairs], dtype=np.float64).reshape(-1, 4, 4))


def clean_poses(stamps_ns: IntArray, T_world_body: FloatArray) -> PoseSeries:
    """Sort poses by time and keep the first of those that share a stamp.

    Args:
        stamps_ns: (N,) int64, in any order; N may be 0.
        T_world_body: (N, 4, 4) float64, metres.

    Raises:
        EvaluationError: a pose is not finite.
    """
    broken = np.flatnonzero(~np.isfinite(T_world_body).all(axis=(1, 2)))
    if len(broken):
        raise EvaluationError(f"pose at {stamps_ns[broken[0]]} ns is not finite ({len(broken)} such poses)")
    unique, first = np.unique(stamps_ns, return_index=True)
    return PoseSeries(unique, T_world_body[first])


def synchronize(estimate: PoseSeries, truth: PoseSeries, *, max_gap_s: float) -> SynchronizedPoses:
    """Interpolate the truth at every stamp of the estimate where truth is known.

    A stamp outside the truth's span has none; neither has one strictly between two truth poses that are more than
    ``max_gap_s`` apart. A stamp that a truth pose shares is always used.

    Raises:
        EvaluationError: no stamp of the estimate has truth; the message gives both spans.
    """
    if len(estimate.stamps_ns) == 0 or len(truth.stamps_ns) == 0:
        missing = "estimated pose" if len(estimate.stamps_ns) == 0 else "true pose"
        raise EvaluationError(f"no {missing} to compare")
    stamps = estimate.stamps_ns
    inside = (stamps >= truth.stamps_ns[0]) & (stamps <= truth.stamps_ns[-1])
    after = np.searchsorted(truth.stamps_ns, stamps, side="left").clip(0, len(truth.stamps_ns) - 1)
    gaps_ns = truth.stamps_ns[after] - truth.stamps_ns[(after - 1).clip(0)]
    known = inside & ((truth.stamps_ns[after] == stamps) | (gaps_ns <= round(max_gap_s * 1e9)))
    if not known.any():
        raise EvaluationError(
            f"none of {len(stamps)} estimated poses in [{stamps[0]}, {stamps[-1]}] ns has truth, which spans "
            f"[{truth.stamps_ns[0]}, {truth.stamps_ns[-1]}] ns with gaps of at most {max_gap_s:g} s bridged; "
            "give the ground truth of this drive, with the same clock"
        )
    return SynchronizedPoses(
        stamps[known],
        estimate.T_world_body[known],
        interpolate(truth.stamps_ns, truth.T_world_body, stamps[known]),
    )
