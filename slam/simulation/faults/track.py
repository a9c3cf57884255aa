"""The poses of a log's odometry, and how faults change them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from logs.messages import Odometry
from slam.common.arrays import FloatArray, IntArray
from slam.common.geometry import invert
from slam.simulation.faults.stream import Entry, Stream, odometry_of, span_from_half, stamp_at


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """Poses T_odom_body (N, 4, 4) at stamps_ns (N,), in the order of the log, of a stream of messages."""

    stream: Stream
    stamps_ns: IntArray
    poses: FloatArray

    def __len__(self) -> int:
        return len(self.stamps_ns)

    @property
    def steps(self) -> FloatArray:
        """T_previous_next (N - 1, 4, 4)."""
        return steps_of(self.poses)

    def row_at(self, fraction: float) -> int:
        """The first pose after a part of the time of the drive, N where there is none."""
        return int(np.searchsorted(self.stamps_ns, stamp_at(self.stream, fraction)))

    def last_row_at(self, fraction: float) -> int:
        """As :meth:`row_at`, the last pose where there is none."""
        return min(self.row_at(fraction), len(self) - 1)

    def span_ns(self, seconds: float) -> tuple[int, int]:
        """Stamps of half time, and so long after it."""
        return span_from_half(self.stream, seconds)

    def redirected(self, row: int, T_jump: FloatArray) -> FloatArray:
        """The poses, those from ``row`` on moved rigidly, by ``T_jump`` (4, 4) in the axes of the body at ``row``."""
        changed = self.poses.copy()
        if row < len(changed):
            changed[row:] = changed[row] @ T_jump @ invert(changed[row]) @ changed[row:]
        return changed

    def chained(self, steps: FloatArray) -> FloatArray:
        """Poses (N, 4, 4) from the first one on by N - 1 steps."""
        return chain(self.poses[0], steps)


def track_of(stream: Stream) -> Track:
    """The odometry of a stream.

    Raises:
        SimulationError: the log holds no odometry.
    """
    return Track(stream, *odometry_of(stream))


def with_poses(stream: Stream, T_odom_body: FloatArray) -> list[Entry]:
    """The stream with the poses (N, 4, 4) in its N messages of odometry."""
    rows = iter(T_odom_body)
    return [e.with_fields(T_odom_body=next(rows)) if isinstance(e.content, Odometry) else e for e in stream]


def steps_of(poses: FloatArray) -> FloatArray:
    """T_previous_next (N - 1, 4, 4) of N poses."""
    return invert(poses[:-1]) @ poses[1:]


def chain(first: FloatArray, steps: FloatArray) -> FloatArray:
    """Poses (N, 4, 4) from the ``first`` (4, 4) on by N - 1 steps."""
    poses = [first]
    for step in steps:
        poses.append(poses[-1] @ step)
    return np.array(poses)
