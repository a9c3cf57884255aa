"""Scans in the body frame, from detections in the frames of their sensors."""

from __future__ import annotations

import logging

import numpy as np

from logs.messages import ObjectDetections, Odometry
from slam.common.arrays import FloatArray
from slam.common.config import DetectionConfig
from slam.common.geometry import invert
from slam.frontend.input.scan import Scan, make_scan
from slam.frontend.input.sensor_frames import SensorFrames, corrected
from slam.odometry.pose import OdometryPose

logger = logging.getLogger(__name__)


class ScanPlacer:
    """Places detections on the body by the transforms of the log; ``frames`` may still grow."""

    def __init__(self, config: DetectionConfig, frames: SensorFrames) -> None:
        self._config = config
        self._frames = frames
        self._body_frame = ""
        self._odom_frame = ""
        self._missing: set[str] = set()

    def follow(self, odometry: Odometry) -> None:
        """Take the names of the body and the odometry frame from a message."""
        self._body_frame, self._odom_frame = odometry.child_frame_id, odometry.frame_id

    def place(self, detections: ObjectDetections, pose: OdometryPose) -> Scan | None:
        """The scan of detections made at ``pose``; None where the log has no transform to the body."""
        T_body_sensor = self._sensor_pose(detections, pose)
        if T_body_sensor is None:
            return None
        return make_scan(detections, T_body_sensor, self._config, pose.T_odom_body[2, :3])

    def _sensor_pose(self, detections: ObjectDetections, pose: OdometryPose) -> FloatArray | None:
        """``T_body_sensor`` at the stamp of the detections; None where the log has no transform."""
        frame, body_frame = detections.frame_id.lstrip("/"), self._body_frame.lstrip("/")
        if frame in ("", body_frame) or self._config.assume_body_frame:
            return corrected(np.eye(4), self._config)
        if frame == self._odom_frame.lstrip("/"):
            return invert(pose.T_odom_body)
        T_body_sensor = self._frames.find(body_frame, frame, detections.stamp_ns)
        if T_body_sensor is None and frame not in self._missing:
            self._missing.add(frame)
            logger.warning("%s: detections in that frame are dropped", self.describe_missing())
        return None if T_body_sensor is None else corrected(T_body_sensor, self._config)

    def describe_missing(self) -> str:
        """Which frames nothing connects with the body, and what they and the body are connected with; empty if none."""
        if not self._missing:
            return ""
        trees = {self._frames.tree_of(frame) for frame in (*self._missing, self._body_frame)}
        listed = "; ".join(", ".join(tree) for tree in sorted(trees))
        return (
            f"no transform leads from {', '.join(sorted(self._missing))} to {self._body_frame} (frames that "
            f"belong together: {listed})"
        )
