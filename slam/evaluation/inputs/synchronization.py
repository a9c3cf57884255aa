"""Synchronization of two series of poses: the truth is interpolated at the stamps of the estimate."""

from collections.abc import Iterable

import numpy as np

from logs.records import frozen
from slam.common.arrays import BoolArray, FloatArray, IntArray
from slam.common.errors import EvaluationError
from slam.common.geometry import interpolate, make_transform, travelled_m
from slam.evaluation.inputs.protocol import Protocol


@frozen
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
        return travelled_m(self.positions)

    def turned(self, R: FloatArray) -> "PoseSeries":
        """The same poses of a body with other axes, which are R (3, 3) in its own."""
        return PoseSeries(self.stamps_ns, self.T_world_body @ make_transform(R, np.zeros(3)))

    def travelled_at_m(self, at_ns: IntArray) -> FloatArray:
        """Path length (M,), metres, at the times ``at_ns`` (M,): linear in between, held beyond both ends; 0 without
        a pose.
        """
        if not self:
            return np.zeros(len(at_ns))
        origin_ns = self.stamps_ns[0]  # Offsets are exact in float64, epoch nanoseconds are not.
        return np.interp(at_ns - origin_ns, self.stamps_ns - origin_ns, self.travelled_m)

    def poses_at(self, at_ns: IntArray) -> FloatArray:
        """T_world_body (M, 4, 4) at any times, in any order, interpolated within the span of the series.

        It is NaN where it is not known: beyond the ends, and strictly between two poses that are more than
        ``max_truth_gap_s`` of the protocol apart.
        """
        T_world_body = np.full((len(at_ns), 4, 4), np.nan)
        if not self:
            return T_world_body
        after = np.searchsorted(self.stamps_ns, at_ns).clip(0, len(self) - 1)
        gaps_ns = self.stamps_ns[after] - self.stamps_ns[(after - 1).clip(0)]
        known = (self.stamps_ns[after] == at_ns) | (gaps_ns <= np.rint(Protocol().max_truth_gap_s * 1e9))
        known &= (at_ns >= self.stamps_ns[0]) & (at_ns <= self.stamps_ns[-1])
        T_world_body[known] = interpolate(self.stamps_ns, self.T_world_body, at_ns[known])
        return T_world_body


def are_known(poses: FloatArray) -> BoolArray:
    """Which of the poses (M, 4, 4) are not NaN: (M,)."""
    return np.isfinite(poses[:, 3, 3])


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


NO_POSES = series_of(())


def synchronize(estimate: PoseSeries, truth: PoseSeries) -> tuple[PoseSeries, PoseSeries]:
    """The estimate and the truth at the stamps of the estimate at which the truth is known, as ``poses_at`` has it.

    Raises:
        EvaluationError: no stamp of the estimate has truth; the message gives both spans.
    """
    if not estimate or not truth:
        raise EvaluationError(f"no {'true' if estimate else 'estimated'} pose to compare")
    stamps_ns = estimate.stamps_ns
    T_world_body = truth.poses_at(stamps_ns)
    known = are_known(T_world_body)
    if not known.any():
        bridged_s = Protocol().max_truth_gap_s
        raise EvaluationError(
            f"none of {len(stamps_ns)} estimated poses in [{stamps_ns[0]}, {stamps_ns[-1]}] ns has truth, which spans "
            f"[{truth.stamps_ns[0]}, {truth.stamps_ns[-1]}] ns with gaps of at most {bridged_s:g} s bridged; "
            "give the ground truth of this drive, with the same clock"
        )
    found = stamps_ns[known]
    return PoseSeries(found, estimate.T_world_body[known]), PoseSeries(found, T_world_body[known])
