"""The odometry as it came in: poses by time, the travel so far, and where the track breaks."""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from logs.messages import Odometry
from slam.common.arrays import FloatArray
from slam.common.config import DetectionConfig, OdometryConfig
from slam.common.geometry import interpolate

# Scans wait for the odometry message that follows them; older ones than this many messages have lost their pose.
HISTORY = 6000
# The speed before a step is the greatest of that many steps, because a single one is noisy.
RECENT_STEPS = 10
# Odometry may be that far off from one message to the next without being called broken, in sensor ranges.
JUMP_SLACK_RANGES = 2.0 / 30.0
# Travel is counted in steps of at least that length, in sensor ranges.
JITTER_RANGES = 0.05 / 30.0
# A pose that is the first one to so many metres (and about as many radians) is the first one again,
RESTART_TOLERANCE = 1e-6
# unless the body was on its way there: no farther off than that from going on as before, in sensor ranges.
RESTART_SLACK_RANGES = 0.25 / 30.0


@dataclass(frozen=True, slots=True, eq=False)
class OdometryPose:
    """One pose on the track; ``travel_m`` is the path length up to it, ``segment`` counts the breaks before it,
    ``speed_mps`` is the speed of the step that led to it,
    the greatest possible where that is not known.
    """

    stamp_ns: int
    T_odom_body: FloatArray
    travel_m: float
    segment: int
    speed_mps: float


class OdometryTrack:
    """The recent past of the odometry, for poses at the times of scans.

    ``counters`` is where it counts the messages that it cannot use; ``sensor_range_m`` is that of the detections.
    """

    def __init__(
        self,
        config: OdometryConfig,
        counters: Counter[str] | None = None,
        *,
        first_segment: int = 0,
        sensor_range_m: float = DetectionConfig().sensor_range_m,
    ) -> None:
        self._config = config
        self._jitter_m = JITTER_RANGES * sensor_range_m
        self._jump_slack_m = JUMP_SLACK_RANGES * sensor_range_m
        self._restart_slack_m = RESTART_SLACK_RANGES * sensor_range_m
        self._first_segment = first_segment
        self._breaks_next = False
        self._poses: deque[OdometryPose] = deque(maxlen=HISTORY)
        self._doubtful: Odometry | None = None
        self._counted_xyz_m = np.zeros(3)
        self._T_odom_first = np.eye(4)
        self._counters = counters if counters is not None else Counter[str]()

    @property
    def latest(self) -> OdometryPose | None:
        """The last pose; None before the first."""
        return self._poses[-1] if self._poses else None

    def add(self, odometry: Odometry) -> list[OdometryPose]:
        """Take in a message; returns the poses that it adds to the track, mostly one.

        A message whose stamp is not later than the last one's adds none. The first message, and one that comes after a
        silence of more than ``max_gap_s``, may have a wrong stamp: it is put off until the next message, which confirms
        or refutes it.
        """
        added = []
        doubtful, self._doubtful = self._doubtful, None
        if doubtful is not None:
            if odometry.stamp_ns > doubtful.stamp_ns:
                added.append(self._append(doubtful))
            else:
                self._reject(odometry.stamp_ns == doubtful.stamp_ns)
        last = self.latest
        if last is None:
            self._doubtful = odometry
        elif odometry.stamp_ns <= last.stamp_ns:
            self._reject(odometry.stamp_ns == last.stamp_ns)
        elif odometry.stamp_ns - last.stamp_ns > self._config.max_gap_s * 1e9:
            self._doubtful = odometry
        else:
            added.append(self._append(odometry))
        return added

    def break_off(self) -> None:
        """Let the next pose begin a new segment: something else than the odometry knows that it is broken."""
        self._breaks_next = True

    def finish(self) -> list[OdometryPose]:
        """Add the message that was put off, if there is one: nothing refutes it any more."""
        doubtful, self._doubtful = self._doubtful, None
        return [] if doubtful is None else [self._append(doubtful)]

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

    def _reject(self, is_duplicate: bool) -> None:
        self._counters["odometry_duplicated" if is_duplicate else "odometry_out_of_order"] += 1

    def _append(self, odometry: Odometry) -> OdometryPose:
        last = self.latest
        xyz_m = odometry.T_odom_body[:3, 3]
        if last is None:
            pose = OdometryPose(
                odometry.stamp_ns, odometry.T_odom_body, 0.0, self._first_segment, self._config.max_speed_mps
            )
            self._counted_xyz_m = xyz_m
            self._T_odom_first = odometry.T_odom_body
        else:
            seconds = (odometry.stamp_ns - last.stamp_ns) * 1e-9
            step_m = float(np.linalg.norm(xyz_m - last.T_odom_body[:3, 3]))
            breaks = (
                seconds > self._config.max_gap_s
                or step_m > self._farthest_step_m(seconds)
                or self._starts_over(odometry, seconds)
                or self._breaks_next
            )
            self._breaks_next = False
            # The jitter of a standing body is no travel.
            counted_m = float(np.linalg.norm(xyz_m - self._counted_xyz_m))
            if breaks or counted_m >= self._jitter_m:
                self._counted_xyz_m = xyz_m
            pose = OdometryPose(
                odometry.stamp_ns,
                odometry.T_odom_body,
                travel_m=last.travel_m + (counted_m if counted_m >= self._jitter_m and not breaks else 0.0),
                segment=last.segment + breaks,
                speed_mps=self._config.max_speed_mps if breaks else step_m / seconds,
            )
        self._poses.append(pose)
        return pose

    def _starts_over(self, odometry: Odometry, seconds: float) -> bool:
        """Whether the odometry was started again: it is where it began, to the last digit, or at the identity.

        A kidnapped robot may continue near the pose of its odometry by chance; that shows no jump.
        """
        T = odometry.T_odom_body
        if not any(np.abs(T - T_start).max() < RESTART_TOLERANCE for T_start in (self._T_odom_first, np.eye(4))):
            return False
        last = self._poses[-1]
        before = self._poses[-2] if len(self._poses) > 1 else last
        passed_s = (last.stamp_ns - before.stamp_ns) * 1e-9
        velocity = (last.T_odom_body - before.T_odom_body)[:3, 3] / passed_s if passed_s > 0.0 else np.zeros(3)
        goes_on = last.T_odom_body[:3, 3] + velocity * seconds
        return float(np.linalg.norm(T[:3, 3] - goes_on)) > self._restart_slack_m

    def _farthest_step_m(self, seconds: float) -> float:
        """How far the body can have come since the last pose; farther is a jump of the odometry."""
        speed_mps = max(pose.speed_mps for pose in islice(reversed(self._poses), RECENT_STEPS))
        reachable_mps = speed_mps + self._config.max_acceleration_mps2 * seconds
        return min(reachable_mps, self._config.max_speed_mps) * seconds + self._jump_slack_m


def _between(before: OdometryPose, after: OdometryPose, stamp_ns: int) -> OdometryPose:
    stamps = np.array([before.stamp_ns, after.stamp_ns])
    T = interpolate(stamps, np.stack([before.T_odom_body, after.T_odom_body]), np.array([stamp_ns]))[0]
    fraction = (stamp_ns - before.stamp_ns) / (after.stamp_ns - before.stamp_ns)
    travel_m = before.travel_m + fraction * (after.travel_m - before.travel_m)
    return replace(after, stamp_ns=stamp_ns, T_odom_body=T, travel_m=travel_m)
