"""The odometry as one track: poses by time, the travel so far, where it breaks, and where it was corrected."""

import math
from array import array
from bisect import bisect_left
from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import replace
from itertools import islice
from operator import attrgetter

import numpy as np

from logs.messages import Odometry
from logs.records import frozen
from slam.common.arrays import FloatArray, IntArray
from slam.common.calibration import Calibration
from slam.common.geometry import blend, invert, relative, rigid, rotation_angle_rad
from slam.odometry.pose import OdometryPose

RECENT_STEPS = 10
"""The speed before a step is the greatest of that many steps, because a single one is noisy."""
MAX_GAP_S = 20.0
"""A longer gap is a discontinuity: the motion in between is unknown."""
MAX_SPEED_RANGES = 2.0
"""A faster step is one, too, in sensor ranges per second: what is in view would be passed within a second."""
# Scans wait for the odometry message that follows them; older ones than this many messages have lost their pose.
HISTORY = 6000


@frozen
class Correction:
    """The correction of a pose of the track by detections.

    ``T_odom`` (4, 4) moves the pose, in the odometry frame; ``variances`` (3,) of the corrected step: of each
    coordinate [m^2], of the tilt and of the heading [rad^2].
    """

    T_odom: FloatArray
    variances: FloatArray


class OdometryTrack:
    """The recent past of the odometry, for poses at the times of scans.

    A step that no body can have made between two successive messages is an error: the body went on as before. Over a
    silence it begins a new segment, until the detections show that it does not: ``correct``.
    ``counters``: of unusable messages. The frame of the track is that of the messages, made level.
    """

    def __init__(self, calibration: Calibration, counters: Counter[str], *, first_segment: int = 0) -> None:
        sensor_range_m = calibration.detection.sensor_range_m
        self._max_speed_mps = MAX_SPEED_RANGES * sensor_range_m
        self._jitter_m = 0.05 / 30.0 * sensor_range_m  # travel is counted in steps of at least that length
        self._sensor_range_m = sensor_range_m
        self._first_segment = first_segment
        self._poses: deque[OdometryPose] = deque(maxlen=HISTORY)
        self._T_odom_reported = calibration.odometry.T_level_odom
        self._corrected = np.zeros(3)
        self._waiting: Odometry | None = None
        self._arrived_ns, self._descends = np.iinfo(np.int64).min, False
        self._counted_xyz_m = np.zeros(3)
        self._counters = counters

    @property
    def latest(self) -> OdometryPose | None:
        """The last pose; None before the first."""
        return self._poses[-1] if self._poses else None

    def add(self, odometry: Odometry) -> list[OdometryPose]:
        """Add a message; returns the poses that it adds to the track, mostly one.

        Messages whose stamp is not later than that of the last pose, or in a series of descending stamps, are left out.
        The first message, and one after a silence that is long beside the last interval, may have a wrong stamp, and a
        message at a place that no body can have reached may be an outlier: the next one decides.
        """
        if odometry.stamp_ns < 0:  # by the correction of its clock; no log can hold such a time
            self._counters["odometry_before_time_zero"] += 1
            return []
        added = []
        descended, self._descends = self._descends, odometry.stamp_ns < self._arrived_ns
        self._arrived_ns = odometry.stamp_ns
        waiting, self._waiting = self._waiting, None
        if waiting is not None:
            if odometry.stamp_ns <= waiting.stamp_ns:
                self._reject(odometry.stamp_ns == waiting.stamp_ns)
            elif self._is_outlier(waiting, odometry):
                self._counters["odometry_wild"] += 1
            else:
                added.append(self._append(waiting))
        last = self.latest
        if last is not None and (odometry.stamp_ns <= last.stamp_ns or (descended and self._descends)):
            self._reject(odometry.stamp_ns == last.stamp_ns)
        elif last is None or self._comes_late(odometry, last.stamp_ns) or self._is_beyond(self._poses, odometry):
            self._waiting = odometry
        else:
            added.append(self._append(odometry, is_near=True))
        return added

    def break_after(self, travel_m: float, *, before_ns: int) -> int:
        """Let a new segment begin after that travel, and not after a time: other evidence shows a discontinuity.

        Returns the stamp of its first pose.
        """
        first = next(i for i, each in enumerate(self._poses) if each.travel_m > travel_m or each.stamp_ns >= before_ns)
        for index in range(first, len(self._poses)):
            self._poses[index] = replace(self._poses[index], segment=self._poses[index].segment + 1)
        return self._poses[first].stamp_ns

    def finish(self) -> list[OdometryPose]:
        """Add the message that waits for the next one, if there is any."""
        waiting, self._waiting = self._waiting, None
        return [] if waiting is None else [self._append(waiting)]

    def correct(self, stamp_ns: int, correction: Correction, *, segment: int) -> None:
        """Correct the track from a time on, or from a break before it, which then is none.

        Args:
            stamp_ns: of the pose that is corrected.
            correction: of that pose, and so of those around it.
            segment: of the last pose that is right.
        """
        self._counters["odometry_corrected"] += 1
        first = len(self._poses) - 1
        while first > 1 and self._poses[first - 1].stamp_ns >= stamp_ns:
            first -= 1
        ends = self._poses[first].segment - segment
        while first > 1 and self._poses[first - 1].segment > segment:
            first -= 1
        self._T_odom_reported = rigid(correction.T_odom @ self._T_odom_reported)
        self._corrected = self._corrected + correction.variances
        before, after = self._poses[first - 1], self._poses[first]
        step_m = np.linalg.norm((correction.T_odom @ after.T_odom_body - before.T_odom_body)[:3, 3])
        extra_m = before.travel_m + float(step_m) - after.travel_m
        for index in range(first, len(self._poses)):
            pose = self._poses[index]
            self._poses[index] = replace(
                pose,
                T_odom_body=correction.T_odom @ pose.T_odom_body,
                T_odom_reported=self._T_odom_reported,
                travel_m=pose.travel_m + extra_m,
                segment=max(pose.segment - ends, segment),
                corrected=self._corrected,
            )
        self._counted_xyz_m = self._poses[-1].T_odom_body[:3, 3]

    def at(self, stamp_ns: int) -> OdometryPose | None:
        """The pose at a time, between the two messages around it; None where the track has none or breaks there."""
        row = bisect_left(self._poses, stamp_ns, key=attrgetter("stamp_ns"))
        if row == len(self._poses):
            return None
        after = self._poses[row]
        if after.stamp_ns == stamp_ns:
            return after
        before = self._poses[row - 1]
        if not row or before.segment != after.segment:
            return None
        fraction = (stamp_ns - before.stamp_ns) / (after.stamp_ns - before.stamp_ns)
        T = blend(before.T_odom_body, after.T_odom_body, fraction)
        travel_m = before.travel_m + fraction * (after.travel_m - before.travel_m)
        return replace(after, stamp_ns=stamp_ns, T_odom_body=T, travel_m=travel_m)

    def _comes_late(self, odometry: Odometry, last_ns: int) -> bool:
        """Whether a message comes after a silence that is long beside the last interval."""
        long_ns = MAX_GAP_S * 1e9
        if len(self._poses) > 1:
            long_ns = min(long_ns, 5.0 * (last_ns - self._poses[-2].stamp_ns))
        return odometry.stamp_ns - last_ns > long_ns

    def _reject(self, is_duplicate: bool) -> None:
        self._counters["odometry_duplicated" if is_duplicate else "odometry_out_of_order"] += 1

    def _is_outlier(self, odometry: Odometry, after: Odometry) -> bool:
        """Whether a body can have come to the pose of the message ``after`` another one, but not to or from that."""
        if not self._poses or self._is_beyond(self._poses, after) or not self._is_beyond(self._poses, odometry):
            return False
        T_odom_body = self._T_odom_reported @ odometry.T_odom_body
        pose = replace(self._poses[-1], stamp_ns=odometry.stamp_ns, T_odom_body=T_odom_body)
        return self._is_beyond([pose], after)

    def _is_beyond(self, poses: Sequence[OdometryPose], odometry: Odometry) -> bool:
        """Whether no body can have made the step from the last of ``poses`` to a message: over a silence, or a jump."""
        last, T_odom_body = poses[-1], self._T_odom_reported @ odometry.T_odom_body
        seconds = (odometry.stamp_ns - last.stamp_ns) * 1e-9
        step_m = math.dist(T_odom_body[:3, 3], last.T_odom_body[:3, 3])
        speed_mps = max(pose.speed_mps for pose in islice(reversed(poses), RECENT_STEPS))
        # Accelerations are at most 5 m/s^2 of a car whose sensor sees 30 m, and messages are wrong by up to 2 m there.
        reachable_mps = speed_mps + self._sensor_range_m / 6.0 * seconds
        farthest_m = min(reachable_mps, self._max_speed_mps) * seconds + 2.0 / 30.0 * self._sensor_range_m
        return seconds > MAX_GAP_S or step_m > farthest_m

    def _append(self, odometry: Odometry, *, is_near: bool = False) -> OdometryPose:
        """``is_near``: a body can have come there."""
        last = self.latest
        jumps = last is not None and not is_near and self._is_beyond(self._poses, odometry)
        if last is not None and jumps and not self._comes_late(odometry, last.stamp_ns):
            self._go_on_as_before(odometry)
            jumps = False
        T_odom_body = self._T_odom_reported @ odometry.T_odom_body
        xyz_m, travel_m, segment, speed_mps = T_odom_body[:3, 3], 0.0, self._first_segment, self._max_speed_mps
        if last is None:
            self._counted_xyz_m = xyz_m
        elif jumps:
            self._counted_xyz_m, travel_m, segment = xyz_m, last.travel_m, last.segment + 1
        else:
            travel_m, segment = last.travel_m, last.segment
            speed_mps = math.dist(xyz_m, last.T_odom_body[:3, 3]) / ((odometry.stamp_ns - last.stamp_ns) * 1e-9)
            counted_m = math.dist(xyz_m, self._counted_xyz_m)
            if counted_m >= self._jitter_m:  # the jitter of a standing body is no travel
                self._counted_xyz_m, travel_m = xyz_m, travel_m + counted_m
        pose = OdometryPose(
            odometry.stamp_ns, T_odom_body, travel_m, segment, speed_mps, self._T_odom_reported, self._corrected
        )
        self._poses.append(pose)
        return pose

    def _go_on_as_before(self, odometry: Odometry) -> None:
        """Correct the track so that the body comes to a message as it moved before, with an error of that size."""
        *recent, last = list(self._poses)[-1 - RECENT_STEPS :]
        first = next((each for each in recent if each.segment == last.segment), last)
        share = (odometry.stamp_ns - last.stamp_ns) / max(last.stamp_ns - first.stamp_ns, 1)
        step = blend(np.eye(4), relative(first.T_odom_body, last.T_odom_body), share)
        way_m2, turn_rad2 = float(step[:3, 3] @ step[:3, 3]), float(rotation_angle_rad(step)) ** 2
        self._corrected = self._corrected + np.array([way_m2, 0.01 * turn_rad2, turn_rad2]) + 1e-8
        self._T_odom_reported = rigid(last.T_odom_body @ step @ invert(odometry.T_odom_body))
        self._counters["odometry_corrected"] += 1


class OdometryPath:
    """All poses of the track so far, 112 bytes each: without objects, as a drive may have millions."""

    def __init__(self) -> None:
        self._stamps_ns = array("q")
        self._segments = array("q")
        self._rows = array("d")  # the upper three rows of each pose
        self.latest: OdometryPose | None = None

    def add(self, pose: OdometryPose) -> None:
        """Add the next pose of the track."""
        self._stamps_ns.append(pose.stamp_ns)
        self._segments.append(pose.segment)
        self._rows.frombytes(pose.T_odom_body[:3].tobytes())
        self.latest = pose

    def break_at(self, stamp_ns: int) -> None:
        """Let a new segment begin with the pose at that time."""
        np.asarray(self._segments)[bisect_left(self._stamps_ns, stamp_ns) :] += 1
        if self.latest is not None:
            self.latest = replace(self.latest, segment=self.latest.segment + 1)

    @property
    def first_stamp_ns(self) -> int:
        """Stamp of the first pose; 0 before it."""
        return self._stamps_ns[0] if self._stamps_ns else 0

    @property
    def stamps_ns(self) -> IntArray:
        """(N,) stamps."""
        return np.array(self._stamps_ns, dtype=np.int64)

    @property
    def segments(self) -> IntArray:
        """(N,) number of breaks before each pose."""
        return np.array(self._segments, dtype=np.int64)

    @property
    def T_odom_body(self) -> FloatArray:
        """(N, 4, 4) m."""
        T = np.zeros((len(self._stamps_ns), 4, 4))
        T[:, :3] = np.array(self._rows).reshape(-1, 3, 4)
        T[:, 3, 3] = 1.0
        return T
