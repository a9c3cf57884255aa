"""A step of the odometry that is not to be expected, and the ways to go on after it."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import Enum

from logs.messages import Odometry
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
class UnexpectedStep:
    """A step that is not to be expected and the messages since then.

    ``first_poses`` has the pose of the first message if the odometry is right, and if the body went on as before where
    that can be said; ``default``: how the track goes on if the detections do not tell; ``is_overdue``: they are late.
    """

    messages: tuple[Odometry, ...]
    first_poses: Mapping[Continuation, OdometryPose]
    default: Continuation
    is_overdue: bool

    @property
    def span_ns(self) -> tuple[int, int]:
        """Times of the first and the last message."""
        return self.messages[0].stamp_ns, self.messages[-1].stamp_ns

    def at(self, stamp_ns: int) -> dict[Continuation, OdometryPose]:
        """The poses at a time within the span."""
        after = bisect_left(self.messages, stamp_ns, key=lambda message: message.stamp_ns)
        return {continuation: self._pose(first, after, stamp_ns) for continuation, first in self.first_poses.items()}

    def _pose(self, first: OdometryPose, after: int, stamp_ns: int) -> OdometryPose:
        following = _moved(first, self.messages[after])
        if following.stamp_ns == stamp_ns:
            return following
        return between(_moved(first, self.messages[after - 1]), following, stamp_ns)


def _moved(first: OdometryPose, message: Odometry) -> OdometryPose:
    """The pose of a message on the track that goes on from the pose of the first message."""
    return replace(first, stamp_ns=message.stamp_ns, T_odom_body=first.T_odom_reported @ message.T_odom_body)
