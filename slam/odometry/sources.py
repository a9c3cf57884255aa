"""Two sources of odometry on one topic: which message is of which."""

from __future__ import annotations

import numpy as np

from logs.messages import Odometry
from slam.common.arrays import FloatArray

ALTERNATING = 6
"""The first messages are taken to come from the two in turn: then each has a velocity."""


class FollowedSource:
    """Follows the source of the first message; the other one's poses stand apart from it.

    A message is of the source that leads nearer to it at the velocity that it had. A jump of both keeps them apart.
    """

    def __init__(self) -> None:
        self._paths: tuple[list[tuple[int, FloatArray]], list[tuple[int, FloatArray]]] = [], []
        self._count = 0

    def follows(self, odometry: Odometry) -> bool:
        """Whether the next message of the topic is of the source that is followed."""
        stamp_ns, xyz_m = odometry.stamp_ns, odometry.T_odom_body[:3, 3]
        if self._count < ALTERNATING or min(map(len, self._paths)) < 2:
            source = self._count % 2
        else:
            misses_m = [float(np.linalg.norm(_predicted(path, stamp_ns) - xyz_m)) for path in self._paths]
            source = int(misses_m[1] < misses_m[0])
        self._count += 1
        path = self._paths[source]
        if not path or stamp_ns > path[-1][0]:
            path.append((stamp_ns, xyz_m))
            del path[:-2]
        return source == 0


def _predicted(path: list[tuple[int, FloatArray]], stamp_ns: int) -> FloatArray:
    """Extrapolation of a path of two positions to a time, at its velocity."""
    (first_ns, first_m), (last_ns, last_m) = path
    return np.asarray(last_m + (last_m - first_m) * ((stamp_ns - last_ns) / (last_ns - first_ns)))
