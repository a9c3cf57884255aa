"""The odometry as one track: poses by time, the travel so far, where it breaks, and where it was mended.

A step that is not to be expected, after a silence, a jump or at another velocity, is held back together with what
follows it, until somebody who has the detections decides how the track goes on: see ``UnexpectedStep``.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from logs.messages import Odometry
from slam.common.arrays import FloatArray
from slam.common.calibration import DetectionCalibration
from slam.common.geometry import invert, make_transform
from slam.odometry.expected_motion import ExpectedMotion
from slam.odometry.pose import OdometryPose, pose_at
from slam.odometry.step_limits import MAX_GAP_S, MAX_SPEED_RANGES, StepLimits
from slam.odometry.unexpected_step import Continuation, Correction, UnexpectedStep

# Scans wait for the odometry message that follows them; older ones than this many messages have lost their pose.
HISTORY = 6000
# A message that comes after a silence of more than so many intervals may have a wrong stamp.
LATE = 5.0
# Travel is counted in steps of at least that length, in sensor ranges.
JITTER_RANGES = 0.05 / 30.0


class OdometryTrack:
    """The recent past of the odometry, for poses at the times of scans.

    ``counters`` is where it counts the messages that it cannot use; ``sensor_range_m`` is that of the detections.
    """

    def __init__(
        self,
        counters: Counter[str] | None = None,
        *,
        first_segment: int = 0,
        sensor_range_m: float = DetectionCalibration().sensor_range_m,
    ) -> None:
        self._max_speed_mps = MAX_SPEED_RANGES * sensor_range_m
        self._jitter_m = JITTER_RANGES * sensor_range_m
        self._limits = StepLimits(sensor_range_m)
        self._first_segment = first_segment
        self._breaks_next = False
        self._poses: deque[OdometryPose] = deque(maxlen=HISTORY)
        self._motion = ExpectedMotion(sensor_range_m)
        self._held: list[Odometry] = []
        self._T_odom_reported = np.eye(4)
        self._mended = np.zeros(2)  # m^2, rad^2
        self._is_frozen = False
        self._T_reported = np.eye(4)
        self._doubtful: Odometry | None = None
        self._arrived_ns, self._falls = np.iinfo(np.int64).min, False
        self._counted_xyz_m = np.zeros(3)
        self._T_odom_first = np.eye(4)
        self._counters = counters if counters is not None else Counter[str]()

    @property
    def latest(self) -> OdometryPose | None:
        """The last pose; None before the first."""
        return self._poses[-1] if self._poses else None

    def add(self, odometry: Odometry) -> list[OdometryPose]:
        """Take in a message; returns the poses that it adds to the track, mostly one.

        A message whose stamp is not later than that of the last pose adds none, nor does one in a row of stamps that
        fall. The first message, and one that comes after a silence that is long beside the last interval, may
        have a wrong stamp: it is put off until the next message, which confirms or refutes it. From an unexpected
        step on, none adds any until ``resolve`` is called.
        """
        if odometry.stamp_ns < 0:  # by the correction of its clock; no log can hold such a time
            self._counters["odometry_before_time_zero"] += 1
            return []
        added = []
        fell, self._falls = self._falls, odometry.stamp_ns < self._arrived_ns
        self._arrived_ns = odometry.stamp_ns
        doubtful, self._doubtful = self._doubtful, None
        if doubtful is not None:
            if odometry.stamp_ns > doubtful.stamp_ns:
                added += self._take(doubtful)
            else:
                self._reject(odometry.stamp_ns == doubtful.stamp_ns)
        last_ns = self._last_ns
        if last_ns is None:
            self._doubtful = odometry
        elif odometry.stamp_ns <= last_ns or (fell and self._falls):
            self._reject(odometry.stamp_ns == last_ns)
        elif self._comes_late(odometry, last_ns):
            self._doubtful = odometry
        else:
            added += self._take(odometry)
        return added

    def break_off(self) -> None:
        """Let the next pose begin a new segment: something else than the odometry knows that it is broken."""
        self._breaks_next = True

    def finish(self) -> list[OdometryPose]:
        """Add what was held back or put off, if there is any: nothing refutes it any more."""
        doubtful, self._doubtful = self._doubtful, None
        added = [] if doubtful is None else self._take(doubtful)
        while (step := self.unexpected) is not None:
            added += self.resolve(step.default)
        return added

    @property
    def unexpected(self) -> UnexpectedStep | None:
        """The step that waits for ``resolve``; None where none does."""
        if not self._held:
            return None
        first, last, before = self._held[0], self._held[-1], self._poses[-1]
        unmended = replace(
            before,
            stamp_ns=first.stamp_ns,
            T_odom_body=self._T_odom_reported @ first.T_odom_body,
            T_odom_reported=self._T_odom_reported,
        )
        poses = {Continuation.REPORTED: unmended}
        T_expected, tolerances = self._motion.predict(first.stamp_ns), self._motion.tolerances(first.stamp_ns)
        frozen_velocity = None
        if T_expected is not None and np.isfinite(tolerances).all():
            poses[Continuation.EXPECTED] = replace(
                unmended,
                T_odom_body=T_expected,
                T_odom_reported=T_expected @ invert(first.T_odom_body),
                mended_m2=before.mended_m2 + float(tolerances[0]) ** 2,
                mended_rad2=before.mended_rad2 + float(tolerances[1]) ** 2,
            )
            if self._repeats(first):
                frozen_velocity = self._motion.velocity
        is_overdue = last.stamp_ns - first.stamp_ns > MAX_GAP_S * 1e9 or len(self._held) >= HISTORY
        default = Continuation.BROKEN if self._is_beyond_limits(first) else Continuation.REPORTED
        return UnexpectedStep(
            tuple(self._held), poses, default, is_overdue, tolerances, frozen_velocity, self._is_frozen
        )

    def resolve(self, continuation: Continuation, correction: Correction | None = None) -> list[OdometryPose]:
        """Go on after an unexpected step; returns the poses that this adds. Another such step may be among them.

        ``correction``: what the detections say of the pose that was expected.
        """
        step = self.unexpected
        assert step is not None
        first, *others = self._held
        self._held = []
        if continuation is Continuation.BROKEN:
            self._breaks_next = True
        elif continuation is Continuation.EXPECTED:
            self._mend(step, correction)
        added = [self._append(first, is_usual=self._is_usual(first), correction=correction)]
        for message in others:
            added += self._take(message)
        return added

    def _mend(self, step: UnexpectedStep, correction: Correction | None) -> None:
        """Let the track go on at the pose that was expected, corrected by the detections."""
        pose, last = step.first_poses[Continuation.EXPECTED], self._poses[-1]
        self._T_odom_reported = pose.T_odom_reported
        self._mended = np.array([pose.mended_m2, pose.mended_rad2])
        if correction is not None:
            self._T_odom_reported = _rigid(correction.T_odom @ pose.T_odom_reported)
            self._mended = np.array([last.mended_m2, last.mended_rad2]) + correction.variances
        self._is_frozen = step.is_frozen
        self._counters["odometry_frozen" if step.is_frozen else "odometry_jumps_mended"] += 1

    def at(self, stamp_ns: int) -> OdometryPose | None:
        """The pose at a time, between the two messages around it; None where the track has none or breaks there."""
        return pose_at(self._poses, stamp_ns)

    def _comes_late(self, odometry: Odometry, last_ns: int) -> bool:
        """Whether a message comes after a silence that is long beside the last interval."""
        long_ns = MAX_GAP_S * 1e9
        if len(self._poses) > 1 and not self._held:
            long_ns = min(long_ns, LATE * (last_ns - self._poses[-2].stamp_ns))
        return odometry.stamp_ns - last_ns > long_ns

    def _reject(self, is_duplicate: bool) -> None:
        self._counters["odometry_duplicated" if is_duplicate else "odometry_out_of_order"] += 1

    @property
    def _last_ns(self) -> int | None:
        """The time of the last message that was taken in."""
        if self._held:
            return self._held[-1].stamp_ns
        return self._poses[-1].stamp_ns if self._poses else None

    def _take(self, odometry: Odometry) -> list[OdometryPose]:
        if self._held:
            if len(self._held) == 1 and self._is_wild(self._held[0], odometry):
                self._counters["odometry_wild"] += not self._repeats(self._held[0])
                self._held = []
                return [self._append(odometry, is_usual=True)]
            self._held.append(odometry)
            return []
        is_usual = self._is_usual(odometry)
        if self._poses and not self._breaks_next and (not is_usual or self._is_beyond_limits(odometry)):
            self._held = [odometry]
            return []
        return [self._append(odometry, is_usual=is_usual)]

    def _is_usual(self, odometry: Odometry) -> bool:
        T_odom_body = self._T_odom_reported @ odometry.T_odom_body
        if self._is_frozen and self._repeats(odometry):
            return False
        return self._motion.is_usual(odometry.stamp_ns, T_odom_body)

    def _is_wild(self, odometry: Odometry, following: Odometry) -> bool:
        """Whether a message alone is off: the following one goes on from before it."""
        seconds = (odometry.stamp_ns - self._poses[-1].stamp_ns) * 1e-9
        T_odom_body = self._T_odom_reported @ odometry.T_odom_body
        starts_over = self._limits.starts_over(
            self._poses,
            odometry.stamp_ns,
            T_odom_body,
            T_reported=odometry.T_odom_body,
            T_first=self._T_odom_first,
        )
        may_be = seconds <= MAX_GAP_S and not starts_over
        return may_be and self._is_usual(following) and not self._is_beyond_limits(following)

    def _is_beyond_limits(self, odometry: Odometry) -> bool:
        return self._limits.is_beyond(
            self._poses,
            odometry.stamp_ns,
            self._T_odom_reported @ odometry.T_odom_body,
            T_reported=odometry.T_odom_body,
            T_first=self._T_odom_first,
        )

    def _append(self, odometry: Odometry, *, is_usual: bool, correction: Correction | None = None) -> OdometryPose:
        last = self.latest
        T_odom_body = self._T_odom_reported @ odometry.T_odom_body
        xyz_m = T_odom_body[:3, 3]
        if last is None:
            self._counted_xyz_m = xyz_m
            self._T_odom_first = odometry.T_odom_body
            self._motion.add(odometry.stamp_ns, T_odom_body)
            pose = OdometryPose(odometry.stamp_ns, T_odom_body, 0.0, self._first_segment, self._max_speed_mps)
        else:
            breaks, self._breaks_next = self._breaks_next, False
            seconds = (odometry.stamp_ns - last.stamp_ns) * 1e-9
            step_m = math.dist(xyz_m, last.T_odom_body[:3, 3])
            # The jitter of a standing body is no travel.
            counted_m = math.dist(xyz_m, self._counted_xyz_m)
            if breaks or counted_m >= self._jitter_m:
                self._counted_xyz_m = xyz_m
            self._is_frozen = self._is_frozen and self._repeats(odometry)
            if correction is not None or self._is_frozen:
                variances = np.zeros(2) if correction is None else correction.variances
                self._motion.correct(odometry.stamp_ns, T_odom_body, variances)
            elif breaks or not (is_usual or self._repeats(odometry)):
                self._motion.restart(odometry.stamp_ns, T_odom_body)
            else:
                self._motion.add(odometry.stamp_ns, T_odom_body)
            pose = OdometryPose(
                odometry.stamp_ns,
                T_odom_body,
                travel_m=last.travel_m + (counted_m if counted_m >= self._jitter_m and not breaks else 0.0),
                segment=last.segment + breaks,
                speed_mps=self._max_speed_mps if breaks else step_m / seconds,
                T_odom_reported=self._T_odom_reported,
                mended_m2=float(self._mended[0]),
                mended_rad2=float(self._mended[1]),
            )
        self._poses.append(pose)
        self._T_reported = odometry.T_odom_body
        return pose

    def _repeats(self, odometry: Odometry) -> bool:
        """Whether a message has the pose of the one before it to the last digit."""
        return bool(np.array_equal(odometry.T_odom_body, self._T_reported))


def _rigid(T: FloatArray) -> FloatArray:
    """``T`` (4, 4) without the rounding that products gather."""
    return make_transform(Rotation.from_matrix(T[:3, :3]).as_matrix(), T[:3, 3])
