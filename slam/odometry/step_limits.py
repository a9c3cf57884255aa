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
MAX_ACCELERATION_RANGES = 1.0 / 6.0
"""... and a step that needs a greater acceleration, in sensor ranges per square second."""
# Odometry may be that far off from one message to the next without being called broken, in sensor ranges.
JUMP_SLACK_RANGES = 2.0 / 30.0


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
    reachable_mps = speed_mps + MAX_ACCELERATION_RANGES * sensor_range_m * seconds
    farthest_m = min(reachable_mps, MAX_SPEED_RANGES * sensor_range_m) * seconds + JUMP_SLACK_RANGES * sensor_range_m
    return seconds > MAX_GAP_S or step_m > farthest_m
