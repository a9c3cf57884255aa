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
from slam.trajectory_check.sampled_scans import SampledScan, ScanSample


class DriveCheck:
    """Samples the scans of a drive, and judges its trajectories by them at the end."""

    def __init__(self, calibration: Calibration) -> None:
        self._sensor_range_m = calibration.detection.sensor_range_m
        self._sigma_m = calibration.objects.landmark_sigma_m
        self._sample = ScanSample()

    def add(self, tracked: Tracked, pose: OdometryPose, T_map_body: FloatArray) -> None:
        """Take the next scan, at a ``pose`` that it has not corrected, and where that was in the map at its time."""
        positions, T_odom_body = tracked.scan.positions, relative(pose.T_odom_reported, pose.T_odom_body)
        self._sample.add(SampledScan(pose.stamp_ns, positions, tracked.labels, pose.travel_m, T_odom_body, T_map_body))

    def judge(self, final: TrajectoryRecord) -> TrajectoryCheck:
        """Judge the odometry, the online estimate and the final trajectory."""
        stamps_ns = np.array([scan.stamp_ns for scan in self._sample.scans], dtype=np.int64)
        is_inside = (stamps_ns >= final.stamps_ns[0]) & (stamps_ns <= final.stamps_ns[-1])
        scans = tuple(compress(self._sample.scans, is_inside.tolist()))
        if not scans:
            return TrajectoryCheck()
        trajectories = {
            ODOMETRY: np.stack([scan.T_odom_body for scan in scans]),
            ONLINE: np.stack([scan.T_online_body for scan in scans]),
            FINAL: interpolate(final.stamps_ns, final.T_map_body, stamps_ns[is_inside]),
        }
        return check_trajectories(scans, trajectories, sensor_range_m=self._sensor_range_m, sigma_m=self._sigma_m)
