"""The odometry as it came in: poses by time, the travel so far, and where the track breaks."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from logs.messages import Odometry
from slam.config import OdometryConfig
from slam.geometry import FloatArray, interpolate, invert, rotation_angle_rad

# Scans wait for the odometry message that follows them; older ones than this many messages have lost their pose.
HISTORY = 600


@dataclass(frozen=True, slots=True, eq=False)
class OdometryPose:
    """One pose on the track; ``travel_m`` is the path length up to it, ``segment`` counts the breaks before it."""

    stamp_ns: int
    T_odom_body: FloatArray
    travel_m: float
    segment: int


class OdometryTrack:
    """The recent past of the odometry, for poses at the times of scans."""

    def __init__(self, config: OdometryConfig) -> None:
        self._config = config
        self._poses: deque[OdometryPose] = deque(maxlen=HISTORY)

    @property
    def latest(self) -> OdometryPose | None:
        """The last pose; None before the first."""
        return self._poses[-1] if self._poses else None

    def add(self, odometry: Odometry) -> OdometryPose | None:
        """Append a message; None if its stamp is not later than the last one's, which leaves the track as it was."""
        last = self.latest
        if last is None:
            pose = OdometryPose(odometry.stamp_ns, odometry.T_odom_body, 0.0, 0)
        elif odometry.stamp_ns <= last.stamp_ns:
            return None
        elif self._breaks(last, odometry):
            pose = OdometryPose(odometry.stamp_ns, odometry.T_odom_body, last.travel_m, last.segment + 1)
        else:
            step_m = float(np.linalg.norm(odometry.T_odom_body[:3, 3] - last.T_odom_body[:3, 3]))
            pose = OdometryPose(odometry.stamp_ns, odometry.T_odom_body, last.travel_m + step_m, last.segment)
        self._poses.append(pose)
        return pose

    def at(self, stamp_ns: int) -> OdometryPose | None:
        """The pose at a time, between the two messages around it; None where the track has none or breaks there."""
        after = None
        for pose in reversed(self._poses):
            if pose.stamp_ns == stamp_ns:
                return pose
            if pose.stamp_ns < stamp_ns:
                return None if after is None or after.segment != pose.segment else _between(pose, after, stamp_ns)
            after = pose
        return None

    def _breaks(self, last: OdometryPose, odometry: Odometry) -> bool:
        seconds = (odometry.stamp_ns - last.stamp_ns) * 1e-9
        step_m = float(np.linalg.norm(odometry.T_odom_body[:3, 3] - last.T_odom_body[:3, 3]))
        return seconds > self._config.max_gap_s or step_m > self._config.max_speed_mps * max(seconds, 0.1)


def step_covariance(T_from_to: FloatArray, travel_m: float, config: OdometryConfig) -> FloatArray:
    """Covariance (6, 6) of a step of the odometry, rotation first, for its travel (at least its straight length)."""
    length_m = max(travel_m, float(np.linalg.norm(T_from_to[:3, 3])))
    # A turn on the spot is no travel and yet not free of error: 0.1 rad count as a metre.
    length_m += 10.0 * float(rotation_angle_rad(T_from_to)) if length_m < 0.5 else 0.0
    root = np.sqrt(length_m)
    tilt = max(config.min_rotation_sigma_rad, config.tilt_sigma * root)
    yaw = max(config.min_rotation_sigma_rad, config.yaw_sigma * root)
    translation = max(config.min_translation_sigma_m, config.translation_sigma * root)
    return np.diag(np.array([tilt, tilt, yaw, translation, translation, translation]) ** 2)


def relative(T_odom_from: FloatArray, T_odom_to: FloatArray) -> FloatArray:
    """``T_from_to`` (4, 4) of two poses of one track."""
    return invert(T_odom_from) @ T_odom_to


def _between(before: OdometryPose, after: OdometryPose, stamp_ns: int) -> OdometryPose:
    stamps = np.array([before.stamp_ns, after.stamp_ns])
    T = interpolate(stamps, np.stack([before.T_odom_body, after.T_odom_body]), np.array([stamp_ns]))[0]
    fraction = (stamp_ns - before.stamp_ns) / (after.stamp_ns - before.stamp_ns)
    return OdometryPose(stamp_ns, T, before.travel_m + fraction * (after.travel_m - before.travel_m), before.segment)
