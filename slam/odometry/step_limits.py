"""Which steps of the odometry no body can have made: silences and jumps."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice

import numpy as np

from slam.common.arrays import FloatArray
from slam.odometry.pose import OdometryPose

# The speed before a step is the greatest of that many steps, because a single one is noisy.
RECENT_STEPS = 10
MAX_GAP_S = 20.0
"""A longer gap is a discontinuity: the motion in between is unknown."""
MAX_SPEED_RANGES = 2.0
"""A faster step is one, too, in sensor ranges per second: what is in view would be passed within a second."""


def is_beyond_limits(
    poses: Sequence[OdometryPose], stamp_ns: int, T_odom_body: FloatArray, *, sensor_range_m: float
) -> bool:
    """Whether a step is a discontinuity if nothing shows that it is not: by a silence or a jump.

    Args:
        poses: those before it.
        stamp_ns: of the pose after it.
        T_odom_body: (4, 4), that pose.
        sensor_range_m: of the detector.
    """
    last = poses[-1]
    seconds = (stamp_ns - last.stamp_ns) * 1e-9
    step_m = float(np.linalg.norm(T_odom_body[:3, 3] - last.T_odom_body[:3, 3]))
    speed_mps = max(pose.speed_mps for pose in islice(reversed(poses), RECENT_STEPS))
    # Accelerations are at most 5 m/s^2 of a car whose sensor sees 30 m, and messages are wrong by up to 2 m there.
    reachable_mps = speed_mps + sensor_range_m / 6.0 * seconds
    farthest_m = min(reachable_mps, MAX_SPEED_RANGES * sensor_range_m) * seconds + 2.0 / 30.0 * sensor_range_m
    return seconds > MAX_GAP_S or step_m > farthest_m
