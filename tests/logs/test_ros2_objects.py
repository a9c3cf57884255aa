"""Objects in ROS 2 messages of every kind."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
import pytest

from logs.decoders.decode import decode
from logs.decoders.registry import ROS_DETECTIONS
from logs.errors import InvalidRecordError, TopicSelectionError
from logs.messages import LabelledScan, ObjectDetections
from logs.selection import select_all, select_topics
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


def test_class_of_the_best_result_at_its_box_or_else_at_its_pose() -> None:
    P = np.diag([0.1, 0.2, 0.3, 0.0, 0.0, 0.0])
    pole, tree = (
        {"hypothesis": {"class_id": name, "score": score}, "pose": {"pose": at(7, 2, 3), "covariance": P}}
        for name, score in (("pole", 0.2), ("tree", 0.7))
    )
    center, size = at(1, 2, 3), vector(1, 1, 2)
    values = {"detections": [{"results": [pole, tree], "bbox": {"center": center, "size": size}, "id": "7"}]}
    (record,) = decoded("vision_msgs/msg/Detection3DArray", values)
    assert (record.labels, record.track_ids, record.scores.tolist()) == (("tree",), ("7",), [0.7])
    np.testing.assert_array_equal(record.positions, [[1, 2, 3]])
    np.testing.assert_array_equal(record.sizes, [[1, 1, 2]])
    np.testing.assert_allclose(record.covariances, [P[:3, :3]])
    lost: dict[str, Any] = {"bbox": {"center": at(np.nan, 0, 0)}}
    unlabelled: dict[str, Any] = {"bbox": {"center": at(1, 0, 0)}}
    values = {"detections": [{"results": [tree]}, unlabelled, lost]}
    (record,) = decoded("vision_msgs/msg/Detection3DArray", values, dropped_objects=1)
    assert (record.labels, record.sizes, record.track_ids) == (("tree", "unknown"), None, None)
    np.testing.assert_array_equal(record.positions, [[7, 2, 3], [1, 0, 0]])


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


@pytest.mark.parametrize("type_name", ROS_DETECTIONS)
def test_an_empty_message_is_an_empty_scan(type_name: str) -> None:
    found = decoded(type_name, {})
    counts = [len(record.classes if isinstance(record, LabelledScan) else record.labels) for record in found]
    assert counts == ([0] if "Marker" not in type_name else [])


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

    with pytest.raises(TopicSelectionError, match="say --topic detections=/particles"):
        select_topics([odometry, poses])
    with pytest.raises(TopicSelectionError, match=r"vision_msgs/msg/Detection3DArray.*foxglove\.SceneUpdate"):
        select_topics([odometry])


def image(type_name: str, values: dict[str, Any], kind: str = "detections") -> list[Any]:
    return list(decode(encoded(("/camera", type_name, SECOND, values)), kind))  # type: ignore[arg-type]


def test_boxes_in_an_image_and_poses_that_a_detector_gives_itself() -> None:
    def box(x: float, label: str, **place: Any) -> dict[str, Any]:
        hypothesis = {"hypothesis": {"class_id": label, "score": 0.5}, "pose": {"pose": place}}
        return {
            "results": [hypothesis],
            "bbox": {"center": {"position": {"x": x, "y": 2.0}}, "size_x": 3.0, "size_y": 4.0},
        }

    values = {"header": header(SECOND, "camera"), "detections": [box(1.0, "tree"), box(9.0, "car", **at(1, 2, 3))]}
    placed, seen = image("vision_msgs/msg/Detection2DArray", values)
    assert (placed.labels, placed.positions.tolist()) == (("car",), [[1.0, 2.0, 3.0]])
    assert (seen.labels, seen.frame_id, seen.boxes.tolist()) == (("tree",), "camera", [[1.0, 2.0, 3.0, 4.0]])


def test_tags_of_the_log() -> None:
    corners = [{"x": 1.0, "y": 5.0}, {"x": 3.0, "y": 5.0}, {"x": 3.0, "y": 2.0}, {"x": 1.0, "y": 2.0}]
    values = {"header": header(SECOND, "camera"), "detections": [{"family": "36h11", "id": 7, "corners": corners}]}
    (seen,) = image("apriltag_msgs/msg/AprilTagDetectionArray", values)
    assert (seen.labels, seen.boxes.tolist()) == (("36h11:7",), [[2.0, 3.5, 2.0, 3.0]])
    assert seen.corners.shape == (1, 4, 2)


def test_camera_info() -> None:
    values = {"header": header(SECOND, "camera"), "k": [500, 0, 320, 0, 510, 240, 0, 0, 1], "d": [0.1, 0.2, 0, 0, 0]}
    (camera,) = image("sensor_msgs/msg/CameraInfo", values, "camera_info")
    assert (camera.frame_id, camera.K[1, 1], camera.distortion.tolist()) == ("camera", 510.0, [0.1, 0.2, 0.0, 0.0, 0.0])
    assert image("sensor_msgs/msg/CameraInfo", {}, "camera_info") == []


@pytest.mark.parametrize(("encoding", "dtype"), [("16UC1", "<u2"), ("32FC1", "<f4"), ("16UC1", ">u2")])
def test_images_with_depth(encoding: str, dtype: str) -> None:
    depths = np.array([[1000, 0, 3000], [500, 2000, 0]], dtype=dtype)
    if encoding == "32FC1":
        depths = (depths * 1e-3).astype(dtype)
    padded = np.zeros((2, 3 * depths.itemsize + 2), np.uint8)
    padded[:, :-2] = np.frombuffer(depths.tobytes(), np.uint8).reshape(2, -1)
    values = {"height": 2, "width": 3, "step": padded.shape[1], "encoding": encoding, "data": padded}
    (found,) = image("sensor_msgs/msg/Image", {**values, "is_bigendian": dtype.startswith(">")}, "depth")
    np.testing.assert_allclose(found.depths, [[1.0, np.nan, 3.0], [0.5, 2.0, np.nan]], rtol=1e-6)
    for wrong in ({"encoding": "rgb8"}, {"height": 3}, {"step": 2}):
        with pytest.raises(InvalidRecordError):
            image("sensor_msgs/msg/Image", {**values, **wrong}, "depth")


def test_cameras_and_depth_are_read_where_objects_are_in_images() -> None:
    odometry = info("/odom", "nav_msgs/msg/Odometry", "odometry", "ground_truth")
    boxes = info("/boxes", "vision_msgs/msg/Detection2DArray", "detections")
    camera = info("/camera_info", "sensor_msgs/msg/CameraInfo", "camera_info")
    images = [info(f"/{name}/image", "sensor_msgs/msg/Image", "depth") for name in ("color", "depth", "aligned_depth")]
    chosen = select_topics([odometry, boxes, camera, *images])
    assert (chosen.topics_of("camera_info"), chosen.topics_of("depth")) == (
        ("/camera_info",),
        ("/aligned_depth/image",),
    )
    objects = info("/objects", "vision_msgs/msg/Detection3DArray", "detections")
    chosen = select_topics([odometry, objects, camera, *images])
    assert chosen.topics == ("/objects", "/odom")
    assert "/color/image" not in select_all([odometry, *images]).topics


def cloud(points: np.ndarray, **fields: Any) -> dict[str, Any]:
    """A PointCloud2 of a structured array (N,)."""
    codes = {"<f4": 7, "<f8": 8, "<u2": 4, "<u4": 6, "|u1": 2}
    described = [
        {"name": name, "offset": points.dtype.fields[name][1], "datatype": codes[kind], "count": 1}
        for name, kind in points.dtype.descr
    ]
    values = {"height": 1, "width": len(points), "fields": described, "point_step": points.itemsize}
    values |= {"row_step": points.nbytes, "data": np.frombuffer(points.tobytes(), np.uint8)}
    return {"header": header(SECOND, "lidar"), **values, **fields}


def scan_of(values: dict[str, Any]) -> Any:
    (record,) = decode(encoded(("/points", "sensor_msgs/msg/PointCloud2", 5 * SECOND, values)), "detections")
    return record


def test_clouds_whose_points_have_a_class() -> None:
    points = np.zeros(3, [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("ring", "<u2"), ("label", "<u4"), ("id", "|u1")])
    points["x"], points["label"], points["id"] = [1.0, np.nan, 3.0], [80, 80, 71], [5, 6, 0]
    record = scan_of(cloud(points))
    assert (record.stamp_ns, record.frame_id) == (SECOND, "lidar")
    assert record.positions[:, 0].tolist() == [1.0, 3.0]
    assert (record.classes.tolist(), record.instances.tolist()) == ([80, 71], [5, 0])


def test_clouds_without_a_class_or_cut_off_are_refused() -> None:
    points = np.zeros(3, [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4")])
    with pytest.raises(InvalidRecordError, match=r"no field holds the class of a point .*; it has x, y, z, intensity"):
        scan_of(cloud(points))
    with pytest.raises(InvalidRecordError, match="lengths disagree"):
        scan_of(cloud(points, width=4))
    with pytest.raises(InvalidRecordError, match="fields of the points are invalid"):
        scan_of(cloud(points, point_step=4, row_step=12))
