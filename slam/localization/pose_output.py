"""The poses that the estimator publishes during the drive."""

from __future__ import annotations

import numpy as np

from logs.messages import Odometry, Record, SlamPose, Transform
from slam.common.arrays import FloatArray
from slam.common.geometry import invert
from slam.odometry.pose import OdometryPose

MAP_FRAME = "map"


class PoseOutput:
    """Messages of the robot's pose. Their odometry is that of the messages, before corrections."""

    def __init__(self) -> None:
        self._T_map_odom = np.eye(4)
        self._odom_frame = self._body_frame = ""

    def follow(self, odometry: Odometry) -> None:
        """Take the names of the body and the odometry frame from a message."""
        self._body_frame, self._odom_frame = odometry.child_frame_id, odometry.frame_id

    def place(self, pose: OdometryPose, T_map_body: FloatArray) -> None:
        """From now on the odometry is placed so that the body is at ``T_map_body`` (4, 4) at ``pose``."""
        self._T_map_odom = T_map_body @ invert(pose.T_odom_body)

    def in_map(self, pose: OdometryPose) -> FloatArray:
        """``T_map_body`` (4, 4) at a pose of the track."""
        return self._T_map_odom @ pose.T_odom_body

    def at(self, pose: OdometryPose, *, is_localized: bool) -> list[Record]:
        """The pose in the odometry frame and, where the robot knows it, in the map."""
        T_odom_body = invert(pose.T_odom_reported) @ pose.T_odom_body
        records: list[Record] = [Transform(pose.stamp_ns, self._odom_frame, self._body_frame, T_odom_body)]
        if is_localized:
            records.append(SlamPose(pose.stamp_ns, self.in_map(pose)))
        return records

    def map_to_odom(self, pose: OdometryPose) -> Transform:
        """The odometry frame in the map, at the time of ``pose``."""
        return Transform(pose.stamp_ns, MAP_FRAME, self._odom_frame, self._T_map_odom @ pose.T_odom_reported)
