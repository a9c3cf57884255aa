"""Steps of the odometry that are physically impossible: gaps, jumps and restarts."""

from __future__ import annotations

from collections.abc import Reversible, Sequence
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
# A pose that is the first one to so many metres (and about as many radians) is the first one again,
RESTART_TOLERANCE = 1e-6
# unless the body was on its way there: no farther off than that from going on as before, in sensor ranges.
RESTART_SLACK_RANGES = 0.25 / 30.0
_IDENTITY = np.eye(4)


class StepLimits:
    """Limits of a step from the last of some poses to a next one."""

    def __init__(self, sensor_range_m: float) -> None:
        self._sensor_range_m = sensor_range_m
        self._jump_slack_m = JUMP_SLACK_RANGES * sensor_range_m
        self._restart_slack_m = RESTART_SLACK_RANGES * sensor_range_m

    def is_beyond(
        self,
        poses: Sequence[OdometryPose],
        stamp_ns: int,
        T_odom_body: FloatArray,
        *,
        T_reported: FloatArray,
        T_first: FloatArray,
    ) -> bool:
        """Whether a step is a discontinuity if nothing shows that it is not: by a silence, a jump or a restart.

        Args:
            poses: those before it.
            stamp_ns: of the pose after it.
            T_odom_body: (4, 4), that pose.
            T_reported: the same, as the message has it.
            T_first: (4, 4), what the first message had.
        """
        last = poses[-1]
        seconds = (stamp_ns - last.stamp_ns) * 1e-9
        step_m = float(np.linalg.norm(T_odom_body[:3, 3] - last.T_odom_body[:3, 3]))
        return (
            seconds > MAX_GAP_S
            or step_m > self._farthest_step_m(poses, seconds)
            or self.starts_over(poses, stamp_ns, T_odom_body, T_reported=T_reported, T_first=T_first)
        )

    def starts_over(
        self,
        poses: Sequence[OdometryPose],
        stamp_ns: int,
        T_odom_body: FloatArray,
        *,
        T_reported: FloatArray,
        T_first: FloatArray,
    ) -> bool:
        """Whether the odometry was started again: it is where it began, to the last digit, or at the identity.

        A kidnapped robot may continue near the pose of its odometry by chance; that shows no jump.
        """
        if not any(np.abs(T_reported - T_start).max() < RESTART_TOLERANCE for T_start in (T_first, _IDENTITY)):
            return False
        last = poses[-1]
        before = poses[-2] if len(poses) > 1 else last
        passed_s = (last.stamp_ns - before.stamp_ns) * 1e-9
        velocity = (last.T_odom_body - before.T_odom_body)[:3, 3] / passed_s if passed_s > 0.0 else np.zeros(3)
        goes_on = last.T_odom_body[:3, 3] + velocity * ((stamp_ns - last.stamp_ns) * 1e-9)
        return float(np.linalg.norm(T_odom_body[:3, 3] - goes_on)) > self._restart_slack_m

    def _farthest_step_m(self, poses: Reversible[OdometryPose], seconds: float) -> float:
        """Limit of the motion since the last pose; a larger step is a jump of the odometry."""
        speed_mps = max(pose.speed_mps for pose in islice(reversed(poses), RECENT_STEPS))
        reachable_mps = speed_mps + MAX_ACCELERATION_RANGES * self._sensor_range_m * seconds
        return min(reachable_mps, MAX_SPEED_RANGES * self._sensor_range_m) * seconds + self._jump_slack_m
