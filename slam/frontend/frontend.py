"""From the messages of a drive to placed scans: the track of the odometry, and the scans among the landmarks around.

A pose of the odometry is handed out once a scan after it has been placed, which may correct it, or none has come for
long.
"""

import logging
from bisect import bisect_right, insort
from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import replace

from logs.messages import DetectionAssociations, ObjectDetections, Odometry
from slam.common.calibration import DetectionCalibration
from slam.common.errors import InputDataError
from slam.common.geometry import invert, relative
from slam.frontend.input.scan import Scan, in_metres, make_scan
from slam.frontend.input.sensor_frames import SensorFrames, find_sensor
from slam.frontend.mapper import Mapper
from slam.frontend.tracker import Tracked
from slam.odometry.keyframe import Keyframe
from slam.odometry.pose import OdometryPose
from slam.odometry.track import MAX_GAP_S, OdometryTrack

Placed = Iterator[OdometryPose | DetectionAssociations]
"""Poses of the track, and the associations of each scan after the poses before it."""

logger = logging.getLogger(__name__)

REJOINING_SCANS = 20
"""Scans that may show that an implausible step is an error of the odometry."""


class Frontend:
    """Tracks the odometry and places the scans of one drive; ``counters`` counts the records.

    Detections wait in the order of their stamps, so that a single stamp from the future holds up nothing. The
    ``frames`` may still grow.
    """

    def __init__(
        self,
        config: DetectionCalibration,
        frames: SensorFrames,
        track: OdometryTrack,
        mapper: Mapper,
        counters: Counter[str],
    ) -> None:
        self._config = config
        self._frames = frames
        self._odometry: Odometry | None = None
        self._missing: set[str] = set()  # frames without a transform to the body
        self._scans: list[ObjectDetections] = []
        self._used_ns, self._used_frames = -1, set[str]()  # of the last scans
        self._track = track
        self._mapper = mapper
        self._tracker = mapper.tracker
        self._counters = counters
        self._waiting: deque[int] = deque()
        self._untold: list[tuple[Tracked, OdometryPose]] = []
        self.placed: tuple[Tracked, OdometryPose] | None = None
        """The last scan that was mapped, and where the odometry had the body before that scan corrected it."""

    @property
    def latest_ns(self) -> int:
        """Stamp of the latest pose; 0 before the first."""
        return 0 if self._track.latest is None else self._track.latest.stamp_ns

    def add_detections(self, detections: ObjectDetections) -> None:
        """Let detections wait for the odometry."""
        insort(self._scans, detections, key=self._time_ns)

    def _time_ns(self, detections: ObjectDetections) -> int:
        """When detections were made, on the clock of the odometry."""
        return detections.stamp_ns + round(self._config.time_offset_s * 1e9)

    def add_odometry(self, odometry: Odometry) -> list[int]:
        """Follow the odometry; returns the stamps of the poses that this adds to the track."""
        self._odometry = odometry
        added_ns = [pose.stamp_ns for pose in self._track.add(odometry)]
        self._waiting += added_ns
        return added_ns

    def break_after(self, travel_m: float, first: Keyframe) -> int:
        """Let a new segment begin after that travel, with the keyframe ``first``: the robot was kidnapped; returns the
        stamp [ns] of the first pose of the segment.
        """
        self._mapper.break_at(first)
        self._untold = []
        return self._track.break_after(travel_m, before_ns=first.odometry.stamp_ns)

    def advance(self) -> Placed:
        """Place the waiting scans up to the newest odometry.

        Yields the poses before each scan, which the caller makes keyframes of, and then its associations.
        """
        if self._track.latest is None:
            return
        count = bisect_right(self._scans, self.latest_ns, key=self._time_ns)
        ready = self._scans[:count]
        del self._scans[:count]
        for detections in ready:
            yield from self._place(detections)
        overdue_ns = self.latest_ns - round(MAX_GAP_S * 1e9)
        if self._untold and self._untold[0][1].stamp_ns <= overdue_ns:
            yield from self._map_untold()
        yield from self._poses_until(overdue_ns)

    def finish(self) -> Placed:
        """The same at the end of the drive, without further scans.

        Raises:
            InputDataError: no detection could be placed, for want of a transform.
        """
        self._waiting += [pose.stamp_ns for pose in self._track.finish()]
        yield from self.advance()
        yield from self._map_untold()
        yield from self._poses_until(self.latest_ns)
        self._counters["detections_without_odometry"] += len(self._scans)
        if not self._missing or self._odometry is None:
            return
        body_frame = self._odometry.child_frame_id
        trees = {self._frames.tree_of(frame) for frame in (*self._missing, body_frame)}
        missing = (
            f"no transform leads from {', '.join(sorted(self._missing))} to {body_frame} (frames that "
            f"belong together: {'; '.join(', '.join(tree) for tree in sorted(trees))})"
        )
        if not self._counters["detections_used"]:
            raise InputDataError(
                f"{missing}, the body frame of the odometry, so no detection could be placed; record "
                "/tf_static, or pass --set calibration.detection.assume_body_frame=true if the detections are in "
                "the body frame"
            )
        logger.warning("%s: detections in that frame are dropped", missing)

    def _place(self, detections: ObjectDetections) -> Placed:
        pose = self._track.at(self._time_ns(detections))
        if pose is None:
            self._counters["detections_without_odometry"] += 1
            return
        scan = self._scan(detections, pose)
        if scan is None:
            return
        segment = self._mapper.segment
        if segment is None or pose.segment <= segment or not self._tracker.is_tracking:
            yield from self._map(scan, pose)
            return
        tracked = self._tracker.rejoin(scan, pose, self._untold)
        if not tracked.is_lost:
            self._untold = []
            yield from self._corrected(tracked, pose, segment)
            return
        self._untold.append((tracked, pose))
        if len(self._untold) == REJOINING_SCANS:
            yield from self._map_untold()

    def _map_untold(self) -> Placed:
        """Map the scans that did not show that a step was none."""
        untold, self._untold = self._untold, []
        for tracked, earlier in untold:
            pose = self._track.at(earlier.stamp_ns)
            if pose is not None:
                yield from self._map(tracked.scan, pose)

    def _map(self, scan: Scan, pose: OdometryPose) -> Placed:
        """Place a scan where the odometry has it, or near there."""
        if pose.segment != self._mapper.segment:
            yield from self._poses_until(pose.stamp_ns)
        yield from self._corrected(self._mapper.locate(scan, pose), pose, pose.segment)

    def _corrected(self, tracked: Tracked, pose: OdometryPose, segment: int) -> Placed:
        """Map a placed scan, with the odometry corrected by it, which is right up to a ``segment``."""
        self.placed = tracked, pose
        if tracked.correction is not None:
            self._track.correct(pose.stamp_ns, tracked.correction, segment=segment)
            pose = replace(pose, T_odom_body=self._tracker.active.T_odom_body)
        yield from self._poses_until(pose.stamp_ns)
        yield self._mapper.add_scan(tracked, pose)

    def _poses_until(self, stamp_ns: int) -> Iterator[OdometryPose]:
        while self._waiting and self._waiting[0] <= stamp_ns:
            if (pose := self._track.at(self._waiting.popleft())) is not None:
                yield pose

    def _scan(self, detections: ObjectDetections, pose: OdometryPose) -> Scan | None:
        """The scan of detections made at ``pose``; None where they cannot be used."""
        stamp_ns, frame = detections.stamp_ns, detections.frame_id
        is_late = stamp_ns < self._used_ns
        if is_late or (stamp_ns == self._used_ns and frame in self._used_frames):
            self._counters["detections_out_of_order" if is_late else "detections_duplicated"] += 1
            return None
        assert self._odometry is not None  # as there is a pose
        T_reported_body = invert(pose.T_odom_reported) @ pose.T_odom_body
        T_body_sensor = find_sensor(self._frames, detections, self._odometry, T_reported_body, self._config)
        if T_body_sensor is None:
            self._counters["detections_without_transform"] += 1
            self._missing.add(frame.lstrip("/"))
            return None
        before = self._track.at(pose.stamp_ns - round(self._config.stamp_sigma_s * 1e9))
        if before is None or before.segment != pose.segment:
            before = pose
        T_body_before, up_body = relative(pose.T_odom_body, before.T_odom_body), pose.T_odom_body[2, :3]
        scan = make_scan(in_metres(detections, self._config), T_body_sensor, self._config, up_body, T_body_before)
        self._used_frames = {frame} | (self._used_frames if stamp_ns == self._used_ns else set())
        self._used_ns = stamp_ns
        self._counters["detections_used"] += 1
        self._counters["detections_without_frame"] += not (frame or self._config.assume_body_frame)
        self._counters["objects_used"] += len(scan.positions)
        self._counters["objects_filtered"] += len(detections.positions) - len(scan.positions)
        return scan
