"""The path of a drive as the odometry has it: every pose, without objects, as a drive may have millions."""

from __future__ import annotations

from array import array
from bisect import bisect_left
from dataclasses import replace

import numpy as np

from slam.common.arrays import FloatArray, IntArray
from slam.odometry.pose import OdometryPose


class OdometryPath:
    """All poses of the track so far, 112 bytes each."""

    def __init__(self) -> None:
        self._stamps_ns = array("q")
        self._segments = array("q")
        self._rows = array("d")  # the upper three rows of each pose
        self.latest: OdometryPose | None = None

    def add(self, pose: OdometryPose) -> None:
        """Add the next pose of the track."""
        self._stamps_ns.append(pose.stamp_ns)
        self._segments.append(pose.segment)
        self._rows.frombytes(pose.T_odom_body[:3].tobytes())
        self.latest = pose

    def break_at(self, stamp_ns: int) -> None:
        """Let a new segment begin with the pose at that time."""
        for index in range(bisect_left(self._stamps_ns, stamp_ns), len(self._stamps_ns)):
            self._segments[index] += 1
        if self.latest is not None:
            self.latest = replace(self.latest, segment=self.latest.segment + 1)

    @property
    def first_stamp_ns(self) -> int:
        """Stamp of the first pose; 0 before it."""
        return self._stamps_ns[0] if self._stamps_ns else 0

    @property
    def stamps_ns(self) -> IntArray:
        """(N,) stamps."""
        return np.array(self._stamps_ns, dtype=np.int64)

    @property
    def segments(self) -> IntArray:
        """(N,) number of breaks before each pose."""
        return np.array(self._segments, dtype=np.int64)

    @property
    def T_odom_body(self) -> FloatArray:
        """(N, 4, 4) m."""
        T = np.zeros((len(self._stamps_ns), 4, 4))
        T[:, :3] = np.array(self._rows).reshape(-1, 3, 4)
        T[:, 3, 3] = 1.0
        return T
