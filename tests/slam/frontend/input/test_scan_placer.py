"""Detections are placed on the body by the transforms of the log."""

import numpy as np
import pytest

from logs.messages import ObjectDetections, Odometry, Transform
from slam.common.calibration import DetectionCalibration
from slam.frontend.input.scan_placer import ScanPlacer
from slam.frontend.input.sensor_frames import SensorFrames
from slam.odometry.pose import OdometryPose
from tests.helpers.landmarks import detections_of
from tests.helpers.poses import pose_at

T_ODOM_BODY = pose_at(5.0, 1.0, yaw=0.5)
POSE = OdometryPose(10, T_ODOM_BODY, 0.0, 0, 1.0)
T_BODY_SENSOR = pose_at(1.0, z=2.0)


def detections(frame_id: str, at: tuple[float, float, float] = (4.0, 0.0, 0.0)) -> ObjectDetections:
    return detections_of(at, stamp_ns=10, frame_id=frame_id)


@pytest.fixture
def placer() -> ScanPlacer:
    frames = SensorFrames()
    frames.add(Transform(0, "base_link", "sensor", T_BODY_SENSOR))
    placer = ScanPlacer(DetectionCalibration(), frames)
    placer.follow(Odometry(10, T_ODOM_BODY, frame_id="odom", child_frame_id="base_link"))
    return placer


@pytest.mark.parametrize(
    ("frame_id", "expected"),
    [("sensor", [5.0, 0.0, 2.0]), ("base_link", [4.0, 0.0, 0.0]), ("/base_link", [4.0, 0.0, 0.0]), ("", [4.0, 0, 0])],
)
def test_detections_come_out_in_the_body_frame(placer, frame_id, expected):
    np.testing.assert_allclose(placer.place(detections(frame_id), POSE).positions, [expected], atol=1e-12)


def test_detections_in_the_odometry_frame_are_seen_from_the_pose(placer):
    (x, y, z), R = T_ODOM_BODY[:3, 3], T_ODOM_BODY[:3, :3]
    ahead = R @ np.array([4.0, 0.0, 0.0])
    scan = placer.place(detections("odom", (x + ahead[0], y + ahead[1], z)), POSE)
    np.testing.assert_allclose(scan.positions, [[4.0, 0.0, 0.0]], atol=1e-12)


def test_detections_in_a_map_of_the_odometry_frame_are_seen_from_the_pose():
    """Of another program that publishes map -> odom: its map is connected with the body by the odometry alone."""
    T_map_odom = pose_at(-3.0, 7.0, yaw=1.0)
    frames = SensorFrames()
    frames.add(Transform(0, "map", "odom", T_map_odom))
    placer = ScanPlacer(DetectionCalibration(), frames)
    placer.follow(Odometry(10, T_ODOM_BODY, frame_id="odom", child_frame_id="base_link"))
    at = T_map_odom @ T_ODOM_BODY @ np.array([4.0, 0.0, 0.0, 1.0])
    np.testing.assert_allclose(placer.place(detections("map", tuple(at[:3])), POSE).positions, [[4, 0, 0]], atol=1e-12)


def test_a_frame_that_nothing_connects_is_named(placer):
    assert placer.describe_missing() == ""
    assert placer.place(detections("camera"), POSE) is None
    assert placer.describe_missing().startswith("no transform leads from camera to base_link")


def test_detections_of_a_tracker_are_taken_from_the_odometry_frame_whatever_they_say():
    placer = ScanPlacer(DetectionCalibration(assume_odometry_frame=True), SensorFrames())
    placer.follow(Odometry(10, T_ODOM_BODY, frame_id="odom", child_frame_id="base_link"))
    at = T_ODOM_BODY @ np.array([4.0, 0.0, 0.0, 1.0])
    for frame in ("base_link", "", "odom", "nowhere"):
        scan = placer.place(detections(frame, tuple(at[:3])), POSE)
        np.testing.assert_allclose(scan.positions, [[4.0, 0.0, 0.0]], atol=1e-12)
