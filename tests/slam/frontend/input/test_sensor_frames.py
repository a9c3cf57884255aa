"""Places of sensors on the body."""

import numpy as np
import pytest

from logs.messages import Odometry, Transform
from slam.common.calibration import DetectionCalibration
from slam.common.errors import InputDataError
from slam.common.geometry import apply, invert
from slam.frontend.input.sensor_frames import SensorFrames, corrected_mount, find_sensor
from tests.helpers.landmarks import detections_of
from tests.helpers.poses import pose_at
from tests.logs.examples import random_transform

T_ODOM_BODY = pose_at(5.0, 1.0, yaw=0.5)


def frames(**T: np.ndarray) -> SensorFrames:
    """Frames from ``parent__child=T_parent_child``."""
    found = SensorFrames()
    for names, transform in T.items():
        parent, child = names.split("__")
        found.add(Transform(0, parent, child, transform))
    return found


def test_a_chain_of_transforms_is_followed_in_both_directions():
    rng = np.random.default_rng(1)
    T_base_mast, T_mast_lidar, T_camera_lidar = (random_transform(rng) for _ in range(3))
    found = frames(base__mast=T_base_mast, mast__lidar=T_mast_lidar, camera__lidar=T_camera_lidar)
    np.testing.assert_allclose(found.find("base", "lidar"), T_base_mast @ T_mast_lidar)
    np.testing.assert_allclose(found.find("base", "camera"), T_base_mast @ T_mast_lidar @ invert(T_camera_lidar))
    np.testing.assert_allclose(found.find("lidar", "base") @ found.find("base", "lidar"), np.eye(4), atol=1e-9)


def test_what_nothing_connects_is_not_found():
    found = frames(base__mast=np.eye(4), world__lidar=np.eye(4))
    assert found.find("base", "lidar") is None
    assert found.find("nowhere", "lidar") is None
    np.testing.assert_array_equal(SensorFrames().find("base", "base"), np.eye(4))


def test_a_later_transform_replaces_the_earlier_one():
    T = pose_at(1.0, 2.0, z=3.0)
    found = frames(base__lidar=np.eye(4))
    found.add(Transform(1, "base", "lidar", T))
    np.testing.assert_array_equal(found.find("base", "lidar"), T)


def test_a_sensor_that_moves_is_interpolated_at_the_stamp():
    found = SensorFrames()
    found.add(Transform(0, "base", "mast", pose_at(z=1.0)))
    for second, yaw, x in ((0, 0.0, 0.0), (2, 0.8, 1.0), (1, 0.2, 0.0)):
        found.add(Transform(second * 10**9, "mast", "camera", pose_at(x, yaw=yaw)))
    for seconds, yaw, x in ((-1.0, 0.0, 0.0), (0.5, 0.1, 0.0), (1.0, 0.2, 0.0), (1.75, 0.65, 0.75), (9.0, 0.8, 1.0)):
        expected = pose_at(x, z=1.0, yaw=yaw)
        np.testing.assert_allclose(found.find("base", "camera", round(seconds * 1e9)), expected, atol=1e-12)
        np.testing.assert_allclose(found.find("camera", "base", round(seconds * 1e9)), invert(expected), atol=1e-12)


def test_what_stands_still_takes_no_memory_and_keeps_its_bits():
    found, T = SensorFrames(), random_transform(np.random.default_rng(2))
    for second in range(1000):
        found.add(Transform(second * 10**9, "base", "lidar", T))
    (track,) = found._tracks.values()
    assert len(track._stamps_ns) == 2
    np.testing.assert_array_equal(found.find("base", "lidar", 500 * 10**9 + 1), T)
    found.add(Transform(2000 * 10**9, "base", "lidar", np.eye(4)))
    np.testing.assert_array_equal(found.find("base", "lidar", 999 * 10**9), T)


def test_a_leading_slash_does_not_matter():
    found = frames(base__lidar=np.eye(4))
    assert found.find("/base", "/lidar") is not None


def test_the_tree_of_a_frame_is_named():
    found = frames(base__mast=np.eye(4), mast__camera=np.eye(4), world__lidar=np.eye(4))
    assert found.tree_of("camera") == ("base", "camera", "mast")
    assert found.tree_of("lidar") == ("lidar", "world")
    assert found.tree_of("radar") == ("radar",)


def test_a_loop_is_named():
    found = frames(base__a=np.eye(4), a__b=np.eye(4), b__c=np.eye(4), c__a=np.eye(4))
    with pytest.raises(InputDataError, match=r"form a loop: (a -> b -> c -> a|b -> c -> a -> b|c -> a -> b -> c),"):
        found.find("base", "c")
    assert frames(base__a=np.eye(4), b__c=np.eye(4), c__b=np.eye(4)).find("base", "a") is not None
    assert frames(base__a=np.eye(4), a__a=np.eye(4)).find("base", "a") is not None


def seen_by_body(frame_id: str, at, config=DetectionCalibration(), **T: np.ndarray):  # noqa: B008
    """Where a detection ``at`` (3,) is in the frame of the body, with these frames, which are so at its stamp only."""
    known = SensorFrames()
    for names, transform in T.items():
        parent, child = names.split("__")
        for stamp_ns, off_m in ((0, 9.0), (10, 0.0), (20, -7.0)):
            known.add(Transform(stamp_ns, parent, child, transform @ pose_at(off_m)))
    detections = detections_of(at, stamp_ns=10, frame_id=frame_id)
    odometry = Odometry(10, T_ODOM_BODY, frame_id="odom", child_frame_id="base_link")
    T_body_sensor = find_sensor(known, detections, odometry, T_ODOM_BODY, config)
    return None if T_body_sensor is None else apply(T_body_sensor, detections.positions)


@pytest.mark.parametrize(
    ("frame_id", "expected"),
    [("sensor", [5.0, 0.0, 2.0]), ("base_link", [4.0, 0.0, 0.0]), ("/base_link", [4.0, 0.0, 0.0]), ("", [4.0, 0, 0])],
)
def test_detections_come_out_in_the_body_frame(frame_id, expected):
    found = seen_by_body(frame_id, (4.0, 0.0, 0.0), base_link__sensor=pose_at(1.0, z=2.0))
    np.testing.assert_allclose(found, [expected], atol=1e-12)


@pytest.mark.parametrize("T_map_odom", [None, pose_at(-3.0, 7.0, yaw=1.0)])
def test_detections_in_the_odometry_frame_or_a_map_of_it_are_seen_from_the_pose(T_map_odom):
    """Of another program that publishes map -> odom: its map is connected with the body by the odometry alone."""
    T = np.eye(4) if T_map_odom is None else T_map_odom
    at = apply(T @ T_ODOM_BODY, np.array([[4.0, 0.0, 0.0]]))
    found = seen_by_body("odom", at) if T_map_odom is None else seen_by_body("map", at, map__odom=T)
    np.testing.assert_allclose(found, [[4.0, 0.0, 0.0]], atol=1e-12)


def test_corrected_mount_turns_a_sensor_where_it_sits_and_shifts_it() -> None:
    config = DetectionCalibration(yaw_deg=90.0, x_m=0.5, y_m=-0.25)
    found = corrected_mount(pose_at(1.0, 2.0, z=3.0, yaw=0.3), config)
    np.testing.assert_allclose(found, pose_at(1.5, 1.75, z=3.0, yaw=0.3 + np.pi / 2.0), atol=1e-12)


def test_a_sensor_that_nothing_connects_has_no_place():
    assert seen_by_body("camera", (4.0, 0.0, 0.0), base_link__sensor=np.eye(4)) is None


def test_detections_of_a_tracker_are_taken_from_the_odometry_frame_whatever_they_say():
    at = apply(T_ODOM_BODY, np.array([[4.0, 0.0, 0.0]]))
    for frame in ("base_link", "", "odom", "nowhere"):
        found = seen_by_body(frame, at, DetectionCalibration(assume_odometry_frame=True))
        np.testing.assert_allclose(found, [[4.0, 0.0, 0.0]], atol=1e-12)
