"""Where the body should be next: it goes on at its last velocity, as nearly as it ever did.

The change of the velocity from step to step is what inertia limits, for any robot; the greatest change so far says what
is usual for this one. A step that needs several times as much is unexpected: a slip or a jump of the odometry, or a
message that is wrong.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from slam.common.arrays import FloatArray
from slam.common.geometry import make_transform, relative

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

    def restart(self, stamp_ns: int, T_odom_body: FloatArray) -> None:
        """Begin at a pose whose velocity is not known; what is usual stays."""
        self._stamp_ns, self._T_odom_body, self._velocity = stamp_ns, T_odom_body, None

    def add(self, stamp_ns: int, T_odom_body: FloatArray) -> None:
        """Take in the next pose, a usual one."""
        if self._T_odom_body is not None:
            seconds = (stamp_ns - self._stamp_ns) * 1e-9
            velocity = _twist(relative(self._T_odom_body, T_odom_body)) / seconds
            if self._velocity is not None:
                change = (velocity - self._velocity).reshape(2, 3)
                self._largest = np.maximum(self._largest, np.linalg.norm(change, axis=1))
                self._steps += 1
            self._velocity = velocity
        self._stamp_ns, self._T_odom_body = stamp_ns, T_odom_body

    def predict(self, stamp_ns: int) -> FloatArray | None:
        """``T_odom_body`` (4, 4) at a later time at the last velocity; None while that is not known."""
        if self._T_odom_body is None or self._velocity is None:
            return None
        return np.asarray(self._T_odom_body @ _motion(self._velocity * (stamp_ns - self._stamp_ns) * 1e-9))

    def tolerances(self, stamp_ns: int) -> FloatArray:
        """How far (2,) from the prediction, in metres and radians, a pose at a later time is still usual."""
        if self._steps < LEAST_STEPS:
            return np.full(2, np.inf)
        seconds = (stamp_ns - self._stamp_ns) * 1e-9
        return np.maximum(UNEXPECTED_RATIO * self._largest * seconds, [self._floor_m, FLOOR_RAD])

    def is_usual(self, stamp_ns: int, T_odom_body: FloatArray) -> bool:
        """Whether a pose at a later time is where the body can be expected."""
        T_predicted = self.predict(stamp_ns)
        if T_predicted is None:
            return True
        deviation = np.linalg.norm(_twist(relative(T_predicted, T_odom_body)).reshape(2, 3), axis=1)
        return bool(np.all(deviation <= self.tolerances(stamp_ns)))


def _twist(T_before_after: FloatArray) -> FloatArray:
    """Translation and rotation vector (6,) of a step."""
    return np.concatenate([T_before_after[:3, 3], Rotation.from_matrix(T_before_after[:3, :3]).as_rotvec()])


def _motion(twist: FloatArray) -> FloatArray:
    return make_transform(Rotation.from_rotvec(twist[3:]).as_matrix(), twist[:3])
