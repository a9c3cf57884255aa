"""A step of the odometry that is not to be expected, and the ways to go on after it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

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

    ``poses`` has those of the messages if the odometry is right, and if the body went on as before where that can be
    said; ``default``: how the track goes on if the detections do not tell; ``is_overdue``: they are late.
    """

    poses: Mapping[Continuation, tuple[OdometryPose, ...]]
    default: Continuation
    is_overdue: bool

    @property
    def span_ns(self) -> tuple[int, int]:
        """Times of the first and the last pose."""
        poses = self.poses[Continuation.REPORTED]
        return poses[0].stamp_ns, poses[-1].stamp_ns

    def at(self, stamp_ns: int) -> dict[Continuation, OdometryPose]:
        """The poses at a time within the span."""
        found = {}
        for continuation, poses in self.poses.items():
            after = next(i for i, pose in enumerate(poses) if pose.stamp_ns >= stamp_ns)
            is_exact = poses[after].stamp_ns == stamp_ns
            found[continuation] = poses[after] if is_exact else between(poses[after - 1], poses[after], stamp_ns)
        return found
