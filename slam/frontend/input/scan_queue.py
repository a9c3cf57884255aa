"""Scans that wait for the odometry to catch up with them."""

from __future__ import annotations

import heapq
from collections.abc import Iterator

from logs.messages import ObjectDetections


class ScanQueue:
    """Detections in the order of their stamps, so that a single stamp from the future holds up nothing.

    ``time_offset_s`` is added to the stamps of the detections, to be on the clock of the odometry.
    """

    def __init__(self, time_offset_s: float = 0.0) -> None:
        self._offset_ns = round(time_offset_s * 1e9)
        self._waiting: list[tuple[int, int, ObjectDetections]] = []
        self._arrivals = 0
        self._last_ns = -1
        self._last_frames: set[str] = set()

    def __len__(self) -> int:
        return len(self._waiting)

    def add(self, detections: ObjectDetections) -> None:
        """Let detections wait for their turn."""
        heapq.heappush(self._waiting, (self.time_ns(detections), self._arrivals, detections))
        self._arrivals += 1

    def time_ns(self, detections: ObjectDetections) -> int:
        """When detections were made, on the clock of the odometry."""
        return detections.stamp_ns + self._offset_ns

    def take(self, until_ns: int) -> Iterator[ObjectDetections]:
        """Those not later than ``until_ns``, one after the other."""
        while self._waiting and self._waiting[0][0] <= until_ns:
            yield heapq.heappop(self._waiting)[2]

    def fault_of(self, detections: ObjectDetections) -> str | None:
        """The counter of what forbids to use detections: they are earlier than the last ones used, or used already."""
        if detections.stamp_ns < self._last_ns:
            return "detections_out_of_order"
        if detections.stamp_ns == self._last_ns and detections.frame_id in self._last_frames:
            return "detections_duplicated"
        return None

    def note_used(self, detections: ObjectDetections) -> None:
        """Remember that detections were used."""
        if detections.stamp_ns > self._last_ns:
            self._last_frames.clear()
        self._last_frames.add(detections.frame_id)
        self._last_ns = detections.stamp_ns
