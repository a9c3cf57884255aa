"""Objects in ROS 2 messages of every kind."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
import pytest

from logs.decoders.decode import decode
from logs.decoders.registry import ROS2_DETECTIONS
from logs.messages import ObjectDetections
from logs.selection import select_topics
from logs.topics import TopicInfo
from tests.helpers.ros2_logs import at, detection3d, encoded, header, vector

SECOND = 10**9


def decoded(type_name: str, values: dict[str, Any], topic: str = "/objects", **counted: int) -> list[ObjectDetections]:
    counters: Counter[str] = Counter()
    found = decode(encoded((topic, type_name, 5 * SECOND, values)), "detections", counters=counters)
    assert counters == counted
    return list(found)


def test_each_detection_is_in_the_frame_and_at_the_stamp_of_its_own_header() -> None:
    values = {
        "header": header(SECOND, "base_link"),
        "detections": [
            detection3d((1, 0, 0), "tree", header=header(SECOND, "left")),
            detection3d((2, 0, 0), "pole"),
            detection3d((3, 0, 0), "pole", header=header(0, "left")),
            detection3d((4, 0, 0), "car", header=header(2 * SECOND, "left")),
        ],
    }
    found = {(r.stamp_ns, r.frame_id): r for r in decoded("vision_msgs/msg/Detection3DArray", values)}
    assert {place: record.positions[:, 0].tolist() for place, record in found.items()} == {
        (SECOND, "left"): [1.0, 3.0],
        (SECOND, "base_link"): [2.0],
        (2 * SECOND, "left"): [4.0],
    }
    assert found[SECOND, "left"].labels == ("tree", "pole")


def test_an_array_whose_detections_have_other_frames_gives_no_empty_record() -> None:
    values = {"detections": [detection3d((1, 0, 0), "tree", header=header(SECOND, "left"))]}
    (record,) = decoded("vision_msgs/msg/Detection3DArray", values)
    assert (record.stamp_ns, record.frame_id) == (SECOND, "left")


def test_zeros_in_a_covariance_are_what_was_not_estimated() -> None:
    plane = np.zeros((6, 6))
    plane[:2, :2] = [[0.04, 0.01], [0.01, 0.09]]
    broken = np.diag([0.1, -0.1, 0.1, 0.0, 0.0, 0.0])
    values = {
        "detections": [
            detection3d((1, 0, 0), "tree", covariance=plane),
            detection3d((2, 0, 0), "tree"),
            detection3d((3, 0, 0), "tree", covariance=broken),
        ]
    }
    (record,) = decoded("vision_msgs/msg/Detection3DArray", values, ignored_covariances=1)
    assert record.covariances is not None
    np.testing.assert_allclose(record.covariances[0], [[0.04, 0.01, 0.0], [0.01, 0.09, 0.0], [0.0, 0.0, 0.09]])
    assert not record.covariances[1:].any()


@pytest.mark.parametrize("given", [(0, 1, 5), (0,), ()])
def test_zeros_in_the_covariance_of_a_pose_are_not_counted_as_ignored(given: tuple[int, ...]) -> None:
    covariance = np.zeros((6, 6))
    covariance[given, given] = 0.1
    values = {"pose": {"pose": at(1, 2, 0), "covariance": covariance}}
    counters: Counter[str] = Counter()
    raw = encoded(("/pose", "geometry_msgs/msg/PoseWithCovarianceStamped", 1, values))
    (record,) = decode(raw, "odometry", counters=counters)
    assert record.covariance is None  # type: ignore[union-attr]
    assert not counters
    covariance[0, 0] = -1.0
    raw = encoded(("/pose", "geometry_msgs/msg/PoseWithCovarianceStamped", 1, values))
    decode(raw, "odometry", counters=counters)
    assert counters == {"ignored_covariances": 1}


@pytest.mark.parametrize("package", ["autoware_perception_msgs", "autoware_auto_perception_msgs"])
@pytest.mark.parametrize("kind", ["Detected", "Tracked"])
def test_autoware(package: str, kind: str) -> None:
    covariance = np.diag([0.1, 0.2, 0.3, 0.0, 0.0, 0.0])
    seen = {
        "existence_probability": 0.75,
        "classification": [{"label": 1, "probability": 0.25}, {"label": 7, "probability": 0.5}],
        "kinematics": {"pose_with_covariance": {"pose": at(1, 2, 3), "covariance": covariance}},
        "shape": {"dimensions": vector(0.5, 0.5, 1.75)},
    }
    if kind == "Detected":
        seen["kinematics"]["has_position_covariance"] = True  # type: ignore[index]
    else:
        seen["object_id"] = {"uuid": np.arange(16)}
    values = {"header": header(SECOND, "base_link"), "objects": [seen]}
    (record,) = decoded(f"{package}/msg/{kind}Objects", values)
    assert (record.labels, record.frame_id, record.stamp_ns) == (("pedestrian",), "base_link", SECOND)
    np.testing.assert_array_equal(record.positions, [[1, 2, 3]])
    np.testing.assert_array_equal(record.scores, [0.75])
    np.testing.assert_allclose(record.covariances, [covariance[:3, :3]])
    np.testing.assert_array_equal(record.sizes, [[0.5, 0.5, 1.75]])
    assert record.track_ids == (None if kind == "Detected" else (bytes(range(16)).hex(),))
    assert record.track_ids is None or len(record.track_ids) == 1


def marker(type: int, *, frame: str = "map", **fields: Any) -> dict[str, Any]:
    return {"header": header(SECOND, frame), "type": type, "pose": at(1, 2, 3), "scale": vector(1, 1, 1), **fields}


def test_markers() -> None:
    listed = [{"x": 1.0, "y": 0.0, "z": 0.0}, {"x": 2.0, "y": 0.0, "z": 0.0}]
    turned = {"position": vector(0, 0, 5), "orientation": {"z": 1.0}}
    values = {
        "markers": [
            {"action": 3},  # deletes all
            marker(1, ns="tree", id=4),
            marker(3, ns="poles", id=5, text="pole"),
            marker(2, frame="lidar", ns="car"),
            marker(10, ns="sign", id=2),
            marker(6, ns="bench", id=6, points=listed, pose=turned),
            marker(9, ns="names", text="a text above it"),
            marker(0, ns="arrow"),
            marker(4, ns="lines", points=listed),
            marker(1, ns="gone", action=2),
        ]
    }
    in_map, in_lidar = decoded("visualization_msgs/msg/MarkerArray", values)
    assert (in_map.frame_id, in_lidar.frame_id, in_lidar.labels) == ("map", "lidar", ("car",))
    assert in_map.labels == ("tree", "pole", "sign", "bench", "bench")
    assert in_map.track_ids == ("tree/4", "poles/5", "sign/2", "bench/6/0", "bench/6/1")
    np.testing.assert_allclose(in_map.positions[-2:], [[-1, 0, 5], [-2, 0, 5]], atol=1e-12)


def test_texts_are_objects_where_there_is_nothing_else() -> None:
    (record,) = decoded("visualization_msgs/msg/MarkerArray", {"markers": [marker(9, ns="names", text="tree")]})
    assert (record.labels, record.sizes) == (("tree",), None)


def test_poses_are_named_after_their_topic() -> None:
    values = {"header": header(SECOND, "lidar"), "poses": [at(1, 2, 3), at(4, 5, 6)]}
    (record,) = decoded("geometry_msgs/msg/PoseArray", values, topic="/map/poles")
    assert (record.labels, record.frame_id) == (("poles", "poles"), "lidar")
    np.testing.assert_array_equal(record.positions, [[1, 2, 3], [4, 5, 6]])


@pytest.mark.parametrize("type_name", ROS2_DETECTIONS)
def test_an_empty_message_is_an_empty_scan(type_name: str) -> None:
    found = decoded(type_name, {})
    assert [len(record.labels) for record in found] == ([0] if "Marker" not in type_name else [])


def info(topic: str, schema: str, *kinds: str) -> TopicInfo:
    return TopicInfo(topic, schema, "cdr", 9, kinds, 0, 1)  # type: ignore[arg-type]


def test_detections_are_preferred_to_markers_and_poses_must_be_asked_for() -> None:
    odometry = info("/odom", "nav_msgs/msg/Odometry", "odometry", "ground_truth")
    poses = info("/particles", "geometry_msgs/msg/PoseArray", "detections")
    drawn = info("/markers", "visualization_msgs/msg/MarkerArray", "detections")
    objects = info("/objects", "autoware_perception_msgs/msg/TrackedObjects", "detections")
    assert select_topics([odometry, poses, drawn, objects]).topics_of("detections") == ("/objects",)
    assert select_topics([odometry, poses, drawn]).topics_of("detections") == ("/markers",)
    chosen = select_topics([odometry, poses], {"detections": "/particles"})
    assert chosen.topics_of("detections") == ("/particles",)
    from logs.errors import TopicSelectionError

    with pytest.raises(TopicSelectionError, match="say --topic detections=/particles"):
        select_topics([odometry, poses])
    with pytest.raises(TopicSelectionError, match=r"vision_msgs/msg/Detection3DArray.*foxglove\.SceneUpdate"):
        select_topics([odometry])
