"""Checks the final trajectory of a drive against its odometry and its online estimate."""

from __future__ import annotations

from itertools import compress

import numpy as np

from logs.messages import TrajectoryRecord
from slam.common.arrays import FloatArray
from slam.common.calibration import Calibration
from slam.common.geometry import interpolate, relative
from slam.frontend.tracker import Tracked
from slam.odometry.pose import OdometryPose
from slam.trajectory_check.judgement import FINAL, ODOMETRY, ONLINE, TrajectoryCheck, check_trajectories
from slam.trajectory_check.prediction import SampledScan

MAX_DETECTIONS = 2**15
"""Detections that are kept, so that the memory of a long drive is bounded: 2 MB."""


class DriveCheck:
    """Samples the scans of a drive evenly, and judges its trajectories by them at the end.

    All scans are kept; every second one once they hold ``MAX_DETECTIONS``, and so on.
    """

    def __init__(self, calibration: Calibration) -> None:
        self._sensor_range_m = calibration.detection.sensor_range_m
        self._sigma_m = calibration.objects.landmark_sigma_m
        self._stride, self._offered = 1, 0
        self._scans: list[SampledScan] = []

    def add(self, tracked: Tracked, pose: OdometryPose, T_map_body: FloatArray) -> None:
        """Take the next scan with detections if it is due, at a ``pose`` that it has not corrected, and where that was
        in the map at its time.
        """
        positions, T_odom_body = tracked.scan.positions, relative(pose.T_odom_reported, pose.T_odom_body)
        if not len(positions):
            return
        if self._offered % self._stride == 0:
            scan = SampledScan(pose.stamp_ns, positions, tracked.labels, pose.travel_m, T_odom_body, T_map_body)
            self._scans.append(scan)
            while sum(len(kept.positions) for kept in self._scans) > MAX_DETECTIONS and len(self._scans) > 1:
                del self._scans[1::2]
                self._stride *= 2
        self._offered += 1

    def judge(self, final: TrajectoryRecord) -> TrajectoryCheck:
        """Judge the odometry, the online estimate and the final trajectory."""
        stamps_ns = np.array([scan.stamp_ns for scan in self._scans], dtype=np.int64)
        is_inside = (stamps_ns >= final.stamps_ns[0]) & (stamps_ns <= final.stamps_ns[-1])
        scans = tuple(compress(self._scans, is_inside.tolist()))
        if not scans:
            return TrajectoryCheck()
        trajectories = {
            ODOMETRY: np.stack([scan.T_odom_body for scan in scans]),
            ONLINE: np.stack([scan.T_online_body for scan in scans]),
            FINAL: interpolate(final.stamps_ns, final.T_map_body, stamps_ns[is_inside]),
        }
        return check_trajectories(scans, trajectories, sensor_range_m=self._sensor_range_m, sigma_m=self._sigma_m)
