"""A step of the odometry that is not to be expected, and the ways to go on after it."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np

from logs.messages import Odometry
from slam.common.arrays import FloatArray
from slam.odometry.expected_motion import motion
from slam.odometry.pose import OdometryPose, between


class Continuation(Enum):
    """How the track goes on at an unexpected step."""

    REPORTED = "reported"
    """The odometry is right."""
    EXPECTED = "expected"
    """The body went on as before; the odometry has jumped."""
    BROKEN = "broken"
    """Nothing is known of the step."""


@dataclass(frozen=True, slots=True, eq=False)
class Correction:
    """What the detections say of the pose that was expected: ``T_odom`` (4, 4) moves it, in the odometry frame;
    ``variances`` (2,) of what is left, m^2 and rad^2.
    """

    T_odom: FloatArray
    variances: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class UnexpectedStep:
    """A step that is not to be expected and the messages since then.

    ``first_poses`` has the pose of the first message if the odometry is right, and if the body went on as before where
    that can be said, with how far off (2,), in metres and radians, that may be; ``default``: how the track goes on if
    the detections do not tell; ``is_overdue``: they are late. ``frozen_velocity`` (6,): the twist at which the body
    should go on where the messages only repeat the last pose; ``goes_on_frozen``: they did so before, and the body
    moved.
    """

    messages: tuple[Odometry, ...]
    first_poses: Mapping[Continuation, OdometryPose]
    default: Continuation
    is_overdue: bool
    tolerances: FloatArray = field(default_factory=lambda: np.zeros(2))
    frozen_velocity: FloatArray | None = None
    goes_on_frozen: bool = False

    @property
    def is_frozen(self) -> bool:
        """Whether the messages only repeat the last pose."""
        return self.frozen_velocity is not None

    @property
    def span_ns(self) -> tuple[int, int]:
        """Times of the first and the last message."""
        return self.messages[0].stamp_ns, self.messages[-1].stamp_ns

    def at(self, stamp_ns: int) -> dict[Continuation, OdometryPose]:
        """The poses at a time within the span."""
        after = bisect_left(self.messages, stamp_ns, key=lambda message: message.stamp_ns)
        poses = {continuation: self._pose(first, after, stamp_ns) for continuation, first in self.first_poses.items()}
        if self.frozen_velocity is not None and Continuation.EXPECTED in poses:
            first = self.first_poses[Continuation.EXPECTED]
            T_moved = motion(self.frozen_velocity * (stamp_ns - first.stamp_ns) * 1e-9)
            poses[Continuation.EXPECTED] = replace(first, stamp_ns=stamp_ns, T_odom_body=first.T_odom_body @ T_moved)
        return poses

    def _pose(self, first: OdometryPose, after: int, stamp_ns: int) -> OdometryPose:
        following = _moved(first, self.messages[after])
        if following.stamp_ns == stamp_ns:
            return following
        return between(_moved(first, self.messages[after - 1]), following, stamp_ns)


def _moved(first: OdometryPose, message: Odometry) -> OdometryPose:
    """The pose of a message on the track that goes on from the pose of the first message."""
    return replace(first, stamp_ns=message.stamp_ns, T_odom_body=first.T_odom_reported @ message.T_odom_body)
