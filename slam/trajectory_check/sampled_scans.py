"""A sample of the scans of a drive, each with the pose that the odometry and the online estimate gave it."""

from __future__ import annotations

from dataclasses import dataclass

from slam.common.arrays import FloatArray, IntArray

MAX_DETECTIONS = 2**15
"""Detections that are kept, so that the memory of a long drive is bounded: 2 MB."""


@dataclass(frozen=True, slots=True, eq=False)
class SampledScan:
    """Detections (D, 3) m in the body frame with their classes (D,), and where the body was.

    ``travel_m``: path length up to the scan; ``T_odom_body`` (4, 4): by the odometry, as it reported; ``T_online_body``
    (4, 4): in the map, as published at the time of the scan.
    """

    stamp_ns: int
    positions: FloatArray
    labels: IntArray
    travel_m: float
    T_odom_body: FloatArray
    T_online_body: FloatArray


class ScanSample:
    """Scans spread evenly over a drive: all of them, every second once they hold ``MAX_DETECTIONS``, ..."""

    def __init__(self) -> None:
        self._stride = 1
        self._offered = 0
        self.scans: list[SampledScan] = []

    def add(self, scan: SampledScan) -> None:
        """Keep the next scan of the drive if it is due; one without detections never is."""
        if not len(scan.positions):
            return
        self._offered += 1
        if (self._offered - 1) % self._stride:
            return
        self.scans.append(scan)
        while sum(len(kept.positions) for kept in self.scans) > MAX_DETECTIONS and len(self.scans) > 1:
            del self.scans[1::2]
            self._stride *= 2
