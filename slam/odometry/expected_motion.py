"""Where the body should be next: it goes on at its last velocity, as nearly as it ever did.

The change of the velocity from step to step is what inertia limits, for any robot; the greatest change so far says what
is usual for this one. A step that needs several times as much is unexpected: a slip or a jump of the odometry, or a
message that is wrong.
"""

from __future__ import annotations

import math

import numpy as np

from slam.common.arrays import FloatArray
from slam.common.geometry import make_transform, relative, rotation_angle_rad, rotation_of, rotation_vector

UNEXPECTED_RATIO = 3.0
"""A change of velocity so many times as great as any before is unexpected."""
LEAST_STEPS = 50
"""Before so many steps nothing is known to be usual."""
FLOOR_RANGES, FLOOR_RAD = 0.01, 0.005
"""Smaller deviations than that, in sensor ranges and in radians, are never unexpected: detections hardly tell them."""


class ExpectedMotion:
    """The last two poses of the body and the greatest changes of its velocity."""

    def __init__(self, sensor_range_m: float) -> None:
        self._floor_m = FLOOR_RANGES * sensor_range_m
        self._largest = np.zeros(2)  # m/s, rad/s
        self._steps = 0
        self._stamp_ns = 0
        self._T_odom_body: FloatArray | None = None
        self._velocity: FloatArray | None = None
        self._velocity_variances = np.zeros(2)  # (m/s)^2, (rad/s)^2

    @property
    def velocity(self) -> FloatArray | None:
        """The last velocity (6,), m/s and rad/s in the axes of the body; None while it is not known."""
        return self._velocity

    def restart(self, stamp_ns: int, T_odom_body: FloatArray) -> None:
        """Begin at a pose whose velocity is not known; what is usual stays."""
        self._stamp_ns, self._T_odom_body, self._velocity = stamp_ns, T_odom_body, None
        self._velocity_variances = np.zeros(2)

    def add(self, stamp_ns: int, T_odom_body: FloatArray) -> None:
        """Take in the next pose, a usual one."""
        if self._T_odom_body is not None:
            seconds = (stamp_ns - self._stamp_ns) * 1e-9
            velocity = _twist(relative(self._T_odom_body, T_odom_body)) / seconds
            if self._velocity is not None and not np.any(self._velocity_variances):
                change = (velocity - self._velocity).reshape(2, 3)
                self._largest = np.maximum(self._largest, np.linalg.norm(change, axis=1))
                self._steps += 1
            self._velocity = velocity
        self._velocity_variances = np.zeros(2)
        self._stamp_ns, self._T_odom_body = stamp_ns, T_odom_body

    def correct(self, stamp_ns: int, T_odom_body: FloatArray, variances: FloatArray) -> None:
        """Take in the next pose as the detections tell it, with ``variances`` (2,) m^2 and rad^2, by a Kalman filter
        of the velocity whose changes are as large as they ever were.
        """
        assert self._T_odom_body is not None
        assert self._velocity is not None
        seconds = (stamp_ns - self._stamp_ns) * 1e-9
        measured = _twist(relative(self._T_odom_body, T_odom_body)) / seconds
        predicted = self._velocity_variances + self._largest**2
        gain = predicted / np.maximum(predicted + 2.0 * variances / seconds**2, 1e-300)
        self._velocity = self._velocity + np.repeat(gain, 3) * (measured - self._velocity)
        self._velocity_variances = (1.0 - gain) * predicted
        self._stamp_ns, self._T_odom_body = stamp_ns, T_odom_body

    def predict(self, stamp_ns: int) -> FloatArray | None:
        """``T_odom_body`` (4, 4) at a later time at the last velocity; None while that is not known."""
        if self._T_odom_body is None or self._velocity is None:
            return None
        return np.asarray(self._T_odom_body @ motion(self._velocity * (stamp_ns - self._stamp_ns) * 1e-9))

    def tolerances(self, stamp_ns: int) -> FloatArray:
        """How far (2,) from the prediction, in metres and radians, a pose at a later time is still usual."""
        if self._steps < LEAST_STEPS:
            return np.full(2, np.inf)
        seconds = (stamp_ns - self._stamp_ns) * 1e-9
        return np.maximum(UNEXPECTED_RATIO * self._change * seconds, [self._floor_m, FLOOR_RAD])

    @property
    def _change(self) -> FloatArray:
        """How much (2,) the velocity may differ from the last one, m/s and rad/s."""
        return np.asarray(self._largest + np.sqrt(self._velocity_variances))

    def is_usual(self, stamp_ns: int, T_odom_body: FloatArray) -> bool:
        """Whether a pose at a later time is where the body can be expected."""
        T_predicted = self.predict(stamp_ns)
        if T_predicted is None or self._velocity is None or self._T_odom_body is None:
            return True
        if np.array_equal(T_odom_body, self._T_odom_body):
            # To the last digit, as a live odometry is only once the body has stopped.
            speeds = np.linalg.norm(self._velocity.reshape(2, 3), axis=1)
            return self._steps < LEAST_STEPS or bool(np.all(speeds <= self._change))
        T_deviation = relative(T_predicted, T_odom_body)
        most_m, most_rad = self.tolerances(stamp_ns).tolist()
        deviation_m = math.hypot(*T_deviation[:3, 3].tolist())
        return bool(deviation_m <= most_m and rotation_angle_rad(T_deviation) <= most_rad)


def _twist(T_before_after: FloatArray) -> FloatArray:
    """Translation and rotation vector (6,) of a step."""
    return np.concatenate([T_before_after[:3, 3], rotation_vector(T_before_after[:3, :3])])


def motion(twist: FloatArray) -> FloatArray:
    """The step (4, 4) of a translation and rotation vector (6,)."""
    return make_transform(rotation_of(twist[3:]), twist[:3])
