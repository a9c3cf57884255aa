"""From messages to placed scans: which poses are handed out, when, and as what."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from logs.messages import DetectionAssociations, ObjectDetections, Odometry
from slam.backend.factor_graph import FactorGraph
from slam.common.arrays import FloatArray
from slam.common.config import Config
from slam.common.errors import InputDataError
from slam.common.geometry import apply, blend, invert, relative
from slam.frontend.frontend import REJOINING_SCANS, Frontend
from slam.frontend.input.sensor_frames import SensorFrames
from slam.frontend.mapper import Mapper
from slam.object_map.landmarks import ObjectMap
from slam.odometry.pose import OdometryPose
from slam.odometry.track import MAX_GAP_S, OdometryTrack
from tests.helpers.landmarks import detections_of, spheres
from tests.helpers.poses import pose_at
from tests.slam.frontend.test_tracker import STEP_NS, T_true, forest

START_NS = 10**9


class Drive:
    """A front end and what it hands out; ``T_fault`` (4, 4) leads from the true frame to that of the odometry."""

    def __init__(self, *, frame_id: str = "base_link", **calibration: float) -> None:
        config = Config().calibrated({key.replace("__", "."): value for key, value in calibration.items()})
        self.counters = Counter[str]()
        object_map = ObjectMap(config.calibration.objects)
        self.mapper = Mapper(config, object_map, FactorGraph())
        track = OdometryTrack(config.calibration, self.counters)
        self.frontend = Frontend(config.calibration.detection, SensorFrames(), track, self.mapper, self.counters)
        self.rng, self.objects, self.frame_id = np.random.default_rng(0), forest(), frame_id
        self.T_fault, self.step = np.eye(4), 0
        self.poses: list[OdometryPose] = []
        self.associations: list[DetectionAssociations] = []

    def drive(self, steps: int, *, sees: bool = True) -> None:
        """So many messages of the odometry, each with detections at its time."""
        for _ in range(steps):
            stamp_ns = START_NS + self.step * STEP_NS
            if sees:
                self.frontend.add_detections(self.detections(stamp_ns))
            self.frontend.add_odometry(Odometry(stamp_ns, self.T_fault @ T_true(self.step)))
            self.take(self.frontend.advance())
            self.step += 1

    def detections(self, stamp_ns: int) -> ObjectDetections:
        positions = apply(invert(T_true(self.step)), self.objects)
        positions = positions[np.linalg.norm(positions, axis=1) < 25.0]
        positions += self.rng.normal(scale=0.03, size=positions.shape)
        covariances = spheres(0.03, len(positions))
        return detections_of(positions, stamp_ns=stamp_ns, frame_id=self.frame_id, covariances=covariances)

    def take(self, placed) -> None:
        for each in placed:
            if isinstance(each, OdometryPose):
                self.poses.append(each)
                self.mapper.add_odometry(each)
            else:
                self.associations.append(each)

    def errors_m(self) -> FloatArray:
        """How far each pose handed out is from the truth."""
        true = [T_true((pose.stamp_ns - START_NS) // STEP_NS)[:3, 3] for pose in self.poses]
        return np.linalg.norm(np.array([pose.T_odom_body[:3, 3] for pose in self.poses]) - true, axis=1)

    def assert_each_once(self) -> None:
        """At the end."""
        self.take(self.frontend.finish())
        stamps_ns = [pose.stamp_ns for pose in self.poses]
        assert stamps_ns == [START_NS + step * STEP_NS for step in range(self.step)]


def restarted(silent_steps: int = 0) -> Drive:
    """A drive whose odometry starts again at its first pose after 30 messages, and so many that are missing."""
    drive = Drive()
    drive.drive(30)
    drive.step += silent_steps
    drive.T_fault = invert(T_true(drive.step))
    return drive


def test_each_pose_is_handed_out_once_as_reported() -> None:
    drive = Drive()
    drive.drive(30)
    drive.assert_each_once()
    assert drive.errors_m().max() == 0.0
    assert len(drive.associations) == 30
    assert drive.counters["detections_used"] == 30


def test_detections_in_the_odometry_frame_are_in_that_of_the_messages() -> None:
    drive, T_odom_body = Drive(odometry__roll_deg=17.0), pose_at(2.0, yaw=0.5)
    drive.frontend.add_detections(detections_of([[4.0, 1.0, 0.0]], stamp_ns=START_NS, frame_id="odom"))
    drive.frontend.add_odometry(Odometry(START_NS, T_odom_body, "odom", "base_link"))
    drive.take(drive.frontend.finish())
    assert drive.frontend.placed is not None
    tracked, _ = drive.frontend.placed
    np.testing.assert_allclose(apply(T_odom_body, tracked.scan.positions), [[4.0, 1.0, 0.0]], atol=1e-9)


def test_noise_of_stamps_is_that_of_the_motion_in_that_time() -> None:
    drive = Drive(detection__stamp_sigma_s=0.5e-9 * STEP_NS)
    drive.drive(10)
    assert drive.frontend.placed is not None
    scan = drive.frontend.placed[0].scan
    moved = apply(relative(T_true(9), blend(T_true(8), T_true(9), 0.5)), scan.positions) - scan.positions
    np.testing.assert_allclose(scan.stamp_shifts, moved, atol=1e-9)


def test_last_pose_is_handed_out_although_no_other_tells_whether_it_is_wild() -> None:
    drive = restarted()
    drive.drive(1)
    assert len(drive.poses) < drive.step
    drive.assert_each_once()


def test_detections_before_and_after_the_odometry_are_counted() -> None:
    drive = Drive()
    drive.frontend.add_detections(drive.detections(START_NS - STEP_NS))
    drive.drive(5)
    for step in (5, 9):
        drive.frontend.add_detections(drive.detections(START_NS + step * STEP_NS))
    drive.assert_each_once()
    assert (drive.counters["detections_used"], drive.counters["detections_without_odometry"]) == (5, 3)


def test_scans_are_taken_in_the_order_of_their_stamps_on_the_clock_of_the_odometry() -> None:
    drive = Drive(detection__time_offset_s=0.5e-9 * STEP_NS)
    for steps in (900, 1, 0):
        drive.frontend.add_detections(drive.detections(START_NS + steps * STEP_NS))
    drive.drive(2, sees=False)
    assert [each.stamp_ns for each in drive.associations] == [START_NS]
    drive.drive(1, sees=False)
    assert [each.stamp_ns for each in drive.associations] == [START_NS, START_NS + STEP_NS]


def test_detections_that_come_twice_or_late_are_used_once() -> None:
    drive = Drive()
    drive.drive(5)
    for step, frame_id in ((4, "base_link"), (4, ""), (4, "base_link"), (3, "base_link")):
        detections = replace(drive.detections(START_NS + step * STEP_NS), frame_id=frame_id)
        drive.frontend.add_detections(detections)
        drive.take(drive.frontend.advance())
    drive.drive(5)
    assert len(drive.associations) == drive.counters["detections_used"] == 11
    assert (drive.counters["detections_duplicated"], drive.counters["detections_out_of_order"]) == (2, 1)


def test_poses_wait_for_a_scan_but_not_forever() -> None:
    drive = Drive()
    drive.drive(10)
    handed_out = len(drive.poses)
    drive.drive(round(MAX_GAP_S * 1e9 / STEP_NS), sees=False)
    assert len(drive.poses) <= handed_out + 1
    drive.drive(20, sees=False)
    assert len(drive.poses) >= handed_out + 20
    drive.assert_each_once()


@pytest.mark.parametrize("yaw", [0.7, -2.0])
def test_poses_are_handed_out_as_corrected(yaw: float) -> None:
    drive = Drive()
    drive.drive(20)
    body = T_true(drive.step)
    drive.T_fault = body @ pose_at(0.5, 0.3, yaw=yaw) @ invert(body)
    drive.drive(10)
    drive.assert_each_once()
    assert drive.errors_m().max() < 0.2
    assert drive.counters["odometry_corrected"] == 1
    assert {pose.segment for pose in drive.poses} == {0}


@pytest.mark.parametrize("silent_steps", [0, 10])
def test_restart_of_the_odometry_among_known_landmarks_begins_no_segment(silent_steps: int) -> None:
    drive = restarted(silent_steps)
    drive.drive(20)
    drive.take(drive.frontend.finish())
    assert drive.errors_m().max() < 0.2
    assert {pose.segment for pose in drive.poses} == {0}


def test_restart_of_the_odometry_in_an_unknown_place_begins_a_segment() -> None:
    drive = restarted(round(MAX_GAP_S * 1e9 / STEP_NS) + 1)
    drive.objects = forest(60, seed=5) - [-3.0, -2.0, 0.0]
    drive.drive(REJOINING_SCANS + 10)
    drive.take(drive.frontend.finish())
    assert [pose.segment for pose in drive.poses] == [0] * 30 + [1] * (REJOINING_SCANS + 10)
    assert drive.counters["odometry_corrected"] == 0


def test_break_at_an_earlier_keyframe_is_not_rejoined() -> None:
    drive = Drive()
    drive.drive(30)
    keyframes = drive.mapper.keyframes
    first = keyframes[-2]
    drive.frontend.break_after(keyframes[-3].odometry.travel_m, first)
    drive.drive(10)
    drive.assert_each_once()
    assert {pose.segment for pose in drive.poses[30:]} == {1}
    assert [each.odometry.segment for each in keyframes] == [0] * first.id + [1] * (len(keyframes) - first.id)


def test_missing_transform_is_an_error_at_the_end() -> None:
    drive = Drive(frame_id="lidar")
    drive.drive(5)
    with pytest.raises(InputDataError, match="no transform leads from lidar to base_link"):
        drive.take(drive.frontend.finish())
    assert drive.counters["detections_without_transform"] == 5


def test_detections_that_name_no_frame_are_those_of_the_body_and_counted() -> None:
    drive = Drive(frame_id="")
    drive.drive(5)
    assert drive.counters["detections_without_frame"] == drive.counters["detections_used"] == 5
