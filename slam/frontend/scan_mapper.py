"""The scans that the odometry has caught up with, brought into the map."""

from __future__ import annotations

from collections import Counter

from logs.messages import DetectionAssociations, ObjectDetections
from slam.common.calibration import DetectionCalibration
from slam.frontend.input.scan_placer import ScanPlacer
from slam.frontend.input.scan_queue import ScanQueue
from slam.frontend.mapper import Mapper
from slam.odometry.track import OdometryTrack


class ScanMapper:
    """Maps waiting scans in the order of their stamps; ``counters`` is where it counts what was used and what not."""

    def __init__(
        self,
        config: DetectionCalibration,
        waiting: ScanQueue,
        placer: ScanPlacer,
        track: OdometryTrack,
        mapper: Mapper,
        counters: Counter[str],
    ) -> None:
        self._config = config
        self._waiting = waiting
        self._placer = placer
        self._track = track
        self._mapper = mapper
        self._counters = counters

    def map_waiting(self, before_ns: int | None = None) -> list[DetectionAssociations]:
        """Map the scans up to the newest pose; ``before_ns`` keeps those at or after it waiting."""
        latest = self._track.latest
        if latest is None:
            return []
        mapped = (self._map(detections) for detections in self._waiting.take(latest.stamp_ns, before_ns))
        return [associations for associations in mapped if associations is not None]

    def _map(self, detections: ObjectDetections) -> DetectionAssociations | None:
        if (fault := self._waiting.fault_of(detections)) is not None:
            self._counters[fault] += 1
            return None
        pose = self._track.at(self._waiting.time_ns(detections))
        # A scan from before a discontinuity does not constrain the keyframes after it.
        if pose is None or not self._mapper.keyframes or pose.segment != self._mapper.keyframes[-1].odometry.segment:
            self._counters["detections_without_odometry"] += 1
            return None
        scan = self._placer.place(detections, pose)
        if scan is None:
            self._counters["detections_without_transform"] += 1
            return None
        self._waiting.note_used(detections)
        self._counters["detections_used"] += 1
        self._counters["detections_without_frame"] += not (detections.frame_id or self._config.assume_body_frame)
        self._counters["objects_used"] += len(scan.positions)
        self._counters["objects_filtered"] += len(detections.positions) - len(scan.positions)
        return self._mapper.add_scan(scan, pose)
