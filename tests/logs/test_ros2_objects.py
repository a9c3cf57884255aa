"""Objects in ROS messages of every kind."""

from collections import Counter
from typing import Any

import numpy as np
import pytest

from logs.decoders.decode import decode
from logs.errors import InvalidRecordError
from tests.helpers.ros2_logs import at, detection3d, encoded, header, vector

SECOND = 10**9


def decoded(type_name: str, values: dict[str, Any], kind: str = "detections", **counted: int) -> list[Any]:
    counters: Counter[str] = Counter()
    found = decode(encoded(("/map/poles", type_name, 5 * SECOND, values)), kind, counters)  # type: ignore[arg-type]
    assert counters == counted
    return list(found)


def test_detections_by_their_own_headers() -> None:
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


def test_detection_is_the_best_result_at_its_box_or_pose() -> None:
    P = np.diag([0.1, 0.2, 0.3, 0.0, 0.0, 0.0])
    pole, tree = (
        {"hypothesis": {"class_id": name, "score": score}, "pose": {"pose": at(7, 2, 3), "covariance": P}}
        for name, score in (("pole", 0.2), ("tree", 0.7))
    )
    box = {"center": at(1, 2, 3), "size": vector(1, 1, 2)}
    (record,) = decoded("vision_msgs/msg/Detection3DArray", {"detections": [{"results": [pole, tree], "bbox": box}]})
    assert (record.labels, record.scores.tolist()) == (("tree",), [0.7])
    np.testing.assert_array_equal(record.positions, [[1, 2, 3]])
    np.testing.assert_allclose(record.covariances, [P[:3, :3]])
    lost, unlabelled = ({"bbox": {"center": at(x, 0, 0)}} for x in (np.nan, 1))
    values = {"detections": [{"results": [tree]}, unlabelled, lost]}
    (record,) = decoded("vision_msgs/msg/Detection3DArray", values, dropped_objects=1)
    assert record.labels == ("tree", "unknown")
    np.testing.assert_array_equal(record.positions, [[7, 2, 3], [1, 0, 0]])


def test_zeros_in_covariance_are_unknown() -> None:
    plane = np.zeros((6, 6))
    plane[:2, :2] = [[0.04, 0.01], [0.01, 0.09]]
    broken = np.diag([0.1, -0.1, 0.1, 0.0, 0.0, 0.0])
    values = {"detections": [detection3d((1, 0, 0), "a", covariance=P) for P in (plane, np.zeros((6, 6)), broken)]}
    (record,) = decoded("vision_msgs/msg/Detection3DArray", values, ignored_covariances=1)
    np.testing.assert_allclose(record.covariances[0], [[0.04, 0.01, 0.0], [0.01, 0.09, 0.0], [0.0, 0.0, 0.09]])
    assert not record.covariances[1:].any()


@pytest.mark.parametrize("package", ["autoware_perception_msgs", "autoware_auto_perception_msgs"])
@pytest.mark.parametrize("kind", ["Detected", "Tracked"])
def test_autoware(package: str, kind: str) -> None:
    covariance = np.diag([0.1, 0.2, 0.3, 0.0, 0.0, 0.0])
    kinematics: dict[str, Any] = {"pose_with_covariance": {"pose": at(1, 2, 3), "covariance": covariance}}
    is_tracked = kind == "Tracked"
    seen = {
        "existence_probability": 0.75,
        "classification": [{"label": 1, "probability": 0.25}, {"label": 7, "probability": 0.5}],
        "kinematics": kinematics if is_tracked else {**kinematics, "has_position_covariance": True},
        "shape": {"dimensions": vector(0.5, 0.5, 1.75)},
        **({"object_id": {"uuid": np.arange(16)}} if is_tracked else {}),
    }
    values = {"header": header(SECOND, "base_link"), "objects": [seen]}
    (record,) = decoded(f"{package}/msg/{kind}Objects", values)
    assert (record.labels, record.frame_id, record.stamp_ns) == (("pedestrian",), "base_link", SECOND)
    np.testing.assert_array_equal(record.positions, [[1, 2, 3]])
    np.testing.assert_allclose(record.covariances, [covariance[:3, :3]])
    assert record.scores.tolist() == [0.75]


def test_markers() -> None:
    def marker(type: int, ns: str, frame: str = "map", **fields: Any) -> dict[str, Any]:
        scale = vector(1, 1, 1)
        return {"header": header(SECOND, frame), "type": type, "ns": ns, "pose": at(1, 2, 3), "scale": scale, **fields}

    values = {
        "markers": [
            {"action": 3},  # deletes all
            marker(1, "tree", id=4),
            marker(3, "poles", id=5, text="pole"),
            marker(2, "car", "lidar"),
            marker(9, "names", text="a text above it"),
            marker(4, "lines"),
            marker(1, "gone", action=2),
        ]
    }
    in_map, in_lidar = decoded("visualization_msgs/msg/MarkerArray", values)
    assert (in_map.frame_id, in_lidar.frame_id, in_lidar.labels) == ("map", "lidar", ("car",))
    assert in_map.labels == ("tree", "pole")


def test_boxes_in_image() -> None:
    box = {"center": {"position": {"x": 1.0, "y": 2.0}}, "size_x": 3.0, "size_y": 4.0}
    results = [{"hypothesis": {"class_id": "tree", "score": 0.5}}]
    values = {"header": header(SECOND, "camera"), "detections": [{"results": results, "bbox": box}]}
    (seen,) = decoded("vision_msgs/msg/Detection2DArray", values)
    assert (seen.labels, seen.frame_id, seen.boxes.tolist()) == (("tree",), "camera", [[1.0, 2.0, 3.0, 4.0]])


def test_tags() -> None:
    corners = [{"x": 1.0, "y": 5.0}, {"x": 3.0, "y": 5.0}, {"x": 3.0, "y": 2.0}, {"x": 1.0, "y": 2.0}]
    values = {"header": header(SECOND, "camera"), "detections": [{"family": "36h11", "id": 7, "corners": corners}]}
    (seen,) = decoded("apriltag_msgs/msg/AprilTagDetectionArray", values)
    assert (seen.labels, seen.boxes.tolist()) == (("36h11:7",), [[2.0, 3.5, 2.0, 3.0]])
    assert seen.corners.shape == (1, 4, 2)


def test_camera_info() -> None:
    values = {"header": header(SECOND, "camera"), "k": [500, 0, 320, 0, 510, 240, 0, 0, 1], "d": [0.1, 0.2, 0, 0, 0]}
    (camera,) = decoded("sensor_msgs/msg/CameraInfo", values, "camera_info")
    assert (camera.frame_id, camera.K[1, 1], camera.distortion.tolist()) == ("camera", 510.0, [0.1, 0.2, 0.0, 0.0, 0.0])
    assert decoded("sensor_msgs/msg/CameraInfo", {}, "camera_info") == []


@pytest.mark.parametrize(("encoding", "dtype"), [("16UC1", "<u2"), ("32FC1", "<f4"), ("16UC1", ">u2")])
def test_images_with_depth(encoding: str, dtype: str) -> None:
    depths = np.array([[1000, 0, 3000], [500, 2000, 0]], dtype=dtype)
    if encoding == "32FC1":
        depths = (depths * 1e-3).astype(dtype)
    padded = np.zeros((2, 3 * depths.itemsize + 2), np.uint8)
    padded[:, :-2] = np.frombuffer(depths.tobytes(), np.uint8).reshape(2, -1)
    values = {"height": 2, "width": 3, "step": padded.shape[1], "encoding": encoding, "data": padded}
    (found,) = decoded("sensor_msgs/msg/Image", {**values, "is_bigendian": dtype.startswith(">")}, "depth")
    np.testing.assert_allclose(found.depths, [[1.0, np.nan, 3.0], [0.5, 2.0, np.nan]], rtol=1e-6)
    for wrong in ({"encoding": "rgb8"}, {"height": 3}, {"step": 2}):
        with pytest.raises(InvalidRecordError):
            decoded("sensor_msgs/msg/Image", {**values, **wrong}, "depth")


def cloud(points: np.ndarray, **fields: Any) -> dict[str, Any]:
    """A PointCloud2 of a structured array (N,)."""
    codes = {"<f4": 7, "<u2": 4, "<u4": 6, "|u1": 2}
    described = [
        {"name": name, "offset": points.dtype.fields[name][1], "datatype": codes[kind], "count": 1}
        for name, kind in points.dtype.descr
    ]
    values = {"height": 1, "width": len(points), "fields": described, "point_step": points.itemsize}
    values |= {"row_step": points.nbytes, "data": np.frombuffer(points.tobytes(), np.uint8)}
    return {"header": header(SECOND, "lidar"), **values, **fields}


def test_clouds_with_classes() -> None:
    points = np.zeros(3, [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("ring", "<u2"), ("label", "<u4"), ("id", "|u1")])
    points["x"], points["label"], points["id"] = [1.0, np.nan, 3.0], [80, 80, 71], [5, 6, 0]
    (record,) = decoded("sensor_msgs/msg/PointCloud2", cloud(points))
    assert (record.stamp_ns, record.frame_id, record.cloud.positions[:, 0].tolist()) == (SECOND, "lidar", [1.0, 3.0])
    assert (record.cloud.classes.tolist(), record.cloud.instances.tolist()) == ([80, 71], [5, 0])


@pytest.mark.parametrize(
    ("fields", "fault"),
    [
        ({}, r"no field holds the class of a point .*; it has x, y, z, intensity"),
        ({"width": 4}, "lengths disagree"),
        ({"point_step": 4, "row_step": 12}, "fields of the points are invalid"),
    ],
)
def test_clouds_without_classes_or_cut_off_are_refused(fields: dict[str, int], fault: str) -> None:
    points = np.zeros(3, [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4")])
    with pytest.raises(InvalidRecordError, match=fault):
        decoded("sensor_msgs/msg/PointCloud2", cloud(points, **fields))
