"""Scans in the body frame, from detections in the frames of their sensors."""

from __future__ import annotations

from logs.messages import ObjectDetections, Odometry
from slam.common.calibration import DetectionCalibration
from slam.frontend.input.scan import Scan, in_metres, make_scan
from slam.frontend.input.sensor_frames import SensorFrames, find_sensor
from slam.odometry.pose import OdometryPose


class ScanPlacer:
    """Places detections on the body by the transforms of the log; ``frames`` may still grow."""

    def __init__(self, config: DetectionCalibration, frames: SensorFrames) -> None:
        self._config = config
        self._frames = frames
        self._odometry: Odometry | None = None
        self._missing: set[str] = set()

    def follow(self, odometry: Odometry) -> None:
        """Take the names of the body and the odometry frame from a message."""
        self._odometry = odometry

    def place(self, detections: ObjectDetections, pose: OdometryPose) -> Scan | None:
        """The scan of detections made at ``pose``; None where the log has no transform to the body."""
        if self._odometry is None:
            return None
        T_body_sensor = find_sensor(self._frames, detections, self._odometry, pose.T_odom_body, self._config)
        if T_body_sensor is None:
            self._missing.add(detections.frame_id.lstrip("/"))
            return None
        return make_scan(in_metres(detections, self._config), T_body_sensor, self._config, pose.T_odom_body[2, :3])

    def describe_missing(self) -> str:
        """The frames without connection to the body, and the frames connected with either; empty if there are none."""
        if not self._missing or self._odometry is None:
            return ""
        body_frame = self._odometry.child_frame_id
        trees = {self._frames.tree_of(frame) for frame in (*self._missing, body_frame)}
        listed = "; ".join(", ".join(tree) for tree in sorted(trees))
        return (
            f"no transform leads from {', '.join(sorted(self._missing))} to {body_frame} (frames that "
            f"belong together: {listed})"
        )
