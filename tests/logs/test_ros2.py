import dataclasses
import math
from collections import Counter

import numpy as np
import pytest
from mcap_ros2.writer import Writer

from logs.decoders.decode import decode
from logs.errors import InvalidRecordError
from logs.reader import LogReader
from logs.selection import Selection, select_topics
from logs.summary import summarize
from tests.helpers.data import NAV2, needs_nav2
from tests.logs.examples import assert_same_record

HEADER = "builtin_interfaces/Time stamp\nstring frame_id"
SEPARATOR = "\n" + "=" * 80 + "\n"


def definition(main, **parts):
    names = {
        "Time": ("builtin_interfaces/Time", "int32 sec\nuint32 nanosec"),
        "Header": ("std_msgs/Header", HEADER),
        "Point": ("geometry_msgs/Point", "float64 x\nfloat64 y\nfloat64 z"),
        "Vector3": ("geometry_msgs/Vector3", "float64 x\nfloat64 y\nfloat64 z"),
        "Quaternion": ("geometry_msgs/Quaternion", "float64 x\nfloat64 y\nfloat64 z\nfloat64 w"),
        "Pose": ("geometry_msgs/Pose", "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation"),
        "PoseWithCovariance": (
            "geometry_msgs/PoseWithCovariance",
            "geometry_msgs/Pose pose\nfloat64[36] covariance",
        ),
        "Transform": (
            "geometry_msgs/Transform",
            "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation",
        ),
        "TransformStamped": (
            "geometry_msgs/TransformStamped",
            "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform",
        ),
        **parts,
    }
    return SEPARATOR.join([main, *(f"MSG: {name}\n{text}" for name, text in names.values())])


POSE_STAMPED = definition("std_msgs/Header header\ngeometry_msgs/Pose pose")
POSE_WITH_COVARIANCE = definition("std_msgs/Header header\ngeometry_msgs/PoseWithCovariance pose")
TF = definition("geometry_msgs/TransformStamped[] transforms")
DETECTIONS = definition(
    "std_msgs/Header header\nvision_msgs/Detection3D[] detections",
    Detection3D=(
        "vision_msgs/Detection3D",
        "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\n"
        "vision_msgs/BoundingBox3D bbox\nstring id",
    ),
    Result=(
        "vision_msgs/ObjectHypothesisWithPose",
        "vision_msgs/ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose",
    ),
    Hypothesis=("vision_msgs/ObjectHypothesis", "string class_id\nfloat64 score"),
    Box=("vision_msgs/BoundingBox3D", "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size"),
)


def header(stamp=(3, 4), frame="odom"):
    return {"stamp": {"sec": stamp[0], "nanosec": stamp[1]}, "frame_id": frame}


def pose(x=1.0, y=2.0, z=3.0, q=(0.0, 0.0, 0.0, 1.0)):
    return {
        "position": {"x": x, "y": y, "z": z},
        "orientation": dict(zip("xyzw", q, strict=True)),
    }


def messages(tmp_path, name, text, *contents):
    path = tmp_path / "ros2.mcap"
    with open(path, "wb") as stream, Writer(stream) as writer:
        schema = writer.register_msgdef(name, text)
        for i, content in enumerate(contents):
            writer.write_message("/topic", schema, content, log_time=100 + i, publish_time=100 + i)
    with LogReader(path) as reader:
        return list(reader.messages())


def test_pose_stamped(tmp_path):
    content = {"header": header(), "pose": pose(q=(0.0, 0.0, 1.0, 0.0))}
    (raw,) = messages(tmp_path, "geometry_msgs/msg/PoseStamped", POSE_STAMPED, content)
    (odometry,) = decode(raw, "odometry")
    (truth,) = decode(raw, "ground_truth")
    expected = np.diag([-1.0, -1.0, 1.0, 1.0])
    expected[:3, 3] = [1, 2, 3]
    np.testing.assert_array_equal(odometry.T_odom_body, expected)
    np.testing.assert_array_equal(truth.T_world_body, expected)
    assert (odometry.stamp_ns, odometry.frame_id, odometry.child_frame_id) == (3_000_000_004, "odom", "base_link")


def test_a_stamp_that_was_not_set_is_the_log_time(tmp_path):
    content = {"header": header(stamp=(0, 0), frame=""), "pose": pose()}
    (raw,) = messages(tmp_path, "geometry_msgs/msg/PoseStamped", POSE_STAMPED, content)
    (record,) = decode(raw, "odometry")
    assert (record.stamp_ns, record.frame_id) == (100, "odom")


def test_a_stamp_before_zero_is_refused(tmp_path):
    content = {"header": header(stamp=(-1, 0)), "pose": pose()}
    (raw,) = messages(tmp_path, "geometry_msgs/msg/PoseStamped", POSE_STAMPED, content)
    with pytest.raises(InvalidRecordError, match="/topic at 100 ns: negative time"):
        decode(raw, "odometry")


def test_pose_with_covariance(tmp_path):
    P = np.diag([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    content = {
        "header": header(frame="map"),
        "pose": {"pose": pose(q=(0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5))), "covariance": P.ravel().tolist()},
    }
    (raw,) = messages(tmp_path, "geometry_msgs/msg/PoseWithCovarianceStamped", POSE_WITH_COVARIANCE, content)
    (record,) = decode(raw, "odometry")
    # A quarter turn about z: what is x in the parent is -y in the body.
    np.testing.assert_allclose(np.diag(record.covariance), [5, 4, 6, 2, 1, 3], atol=1e-12)


def test_tf(tmp_path):
    transforms = [
        {
            "header": header(frame=parent),
            "child_frame_id": child,
            "transform": {"translation": {"x": x, "y": 0.0, "z": 0.0}, "rotation": pose()["orientation"]},
        }
        for parent, child, x in [("map", "odom", 1.0), ("odom", "base_link", 2.0)]
    ]
    (raw,) = messages(tmp_path, "tf2_msgs/msg/TFMessage", TF, {"transforms": transforms})
    records = decode(raw, "transforms")
    assert [(r.parent_frame_id, r.child_frame_id) for r in records] == [("map", "odom"), ("odom", "base_link")]
    (odometry,) = decode(raw, "odometry")
    assert odometry.T_odom_body[0, 3] == 2.0


def result(class_id, score, covariance=None, **place):
    covariance = np.zeros((6, 6)) if covariance is None else covariance
    return {
        "hypothesis": {"class_id": class_id, "score": score},
        "pose": {"pose": pose(**place), "covariance": covariance.ravel().tolist()},
    }


def detection(results, center=(1.0, 2.0, 3.0), size=(1.0, 1.0, 2.0), id=""):
    return {
        "header": header(),
        "results": results,
        "bbox": {"center": pose(*center), "size": dict(zip("xyz", size, strict=True))},
        "id": id,
    }


def test_detections(tmp_path):
    P = np.diag([0.1, 0.2, 0.3, 0.0, 0.0, 0.0])
    content = {
        "header": header(frame="lidar"),
        "detections": [
            detection([result("pole", 0.2, P), result("tree", 0.7, P)], id="7"),
            detection([result("car", 0.5, 2 * P)], center=(4.0, 5.0, 6.0), id="8"),
        ],
    }
    (raw,) = messages(tmp_path, "vision_msgs/msg/Detection3DArray", DETECTIONS, content)
    (record,) = decode(raw, "detections")
    assert (record.labels, record.track_ids, record.frame_id) == (("tree", "car"), ("7", "8"), "odom"), (
        "that of the detections"
    )
    np.testing.assert_array_equal(record.positions, [[1, 2, 3], [4, 5, 6]])
    np.testing.assert_array_equal(record.scores, [0.7, 0.5])
    np.testing.assert_array_equal(record.sizes, [[1, 1, 2], [1, 1, 2]])
    np.testing.assert_allclose(record.covariances[1], np.diag([0.2, 0.4, 0.6]))


def test_detections_without_a_box_are_at_the_pose_of_their_result(tmp_path):
    content = {
        "header": header(),
        "detections": [
            detection([result("tree", 0.7, x=7.0)], center=(0.0, 0.0, 0.0), size=(0.0, 0.0, 0.0)),
            detection([], center=(1.0, 0.0, 0.0)),
            detection([], center=(math.nan, 0.0, 0.0)),
        ],
    }
    (raw,) = messages(tmp_path, "vision_msgs/msg/Detection3DArray", DETECTIONS, content)
    counters = Counter()
    (record,) = decode(raw, "detections", counters)
    assert record.labels == ("tree", "unknown")
    np.testing.assert_array_equal(record.positions, [[7, 2, 3], [1, 0, 0]])
    assert (record.covariances, record.sizes, record.track_ids) == (None, None, None)
    assert counters == {"dropped_objects": 1}


def test_an_empty_array_of_detections(tmp_path):
    (raw,) = messages(tmp_path, "vision_msgs/msg/Detection3DArray", DETECTIONS, {"header": header(), "detections": []})
    (record,) = decode(raw, "detections")
    assert record.positions.shape == (0, 3)
    assert record.labels == ()


def test_a_message_that_is_cut_short_is_refused(tmp_path):
    (raw,) = messages(tmp_path, "geometry_msgs/msg/PoseStamped", POSE_STAMPED, {"header": header(), "pose": pose()})
    for length in range(0, len(raw.data), 7):
        with pytest.raises(InvalidRecordError, match="do not decode"):
            decode(dataclasses.replace(raw, data=raw.data[:length]), "odometry")


def test_a_definition_without_the_usual_fields_is_refused(tmp_path):
    (raw,) = messages(tmp_path, "geometry_msgs/msg/PoseStamped", "float64 x", {"x": 1.0})
    with pytest.raises(InvalidRecordError, match="unknown version of geometry_msgs/msg/PoseStamped"):
        decode(raw, "odometry")


TIME_IDL = "module builtin_interfaces { module msg { struct Time { int32 sec; uint32 nanosec; }; }; };\n"
HEADER_IDL = """#include "builtin_interfaces/msg/Time.idl"
module std_msgs { module msg { struct Header { builtin_interfaces::msg::Time stamp; string frame_id; }; }; };
"""
POSE_IDL = """module geometry_msgs { module msg {
  struct Point { double x; double y; double z; };
  struct Quaternion { double x; double y; double z; double w; };
  struct Pose { geometry_msgs::msg::Point position; geometry_msgs::msg::Quaternion orientation; };
}; };
"""
POSE_STAMPED_IDL = """#include "std_msgs/msg/Header.idl"
module geometry_msgs { module msg {
  struct PoseStamped { std_msgs::msg::Header header; geometry_msgs::msg::Pose pose; };
}; };
"""
IDL = {
    "geometry_msgs/msg/PoseStamped": POSE_STAMPED_IDL,
    "std_msgs/msg/Header": HEADER_IDL,
    "builtin_interfaces/msg/Time": TIME_IDL,
    "geometry_msgs/msg/Pose": POSE_IDL,
}


def test_definitions_in_idl(tmp_path):
    content = {"header": header(), "pose": pose(q=(0.0, 0.0, 1.0, 0.0))}
    (raw,) = messages(tmp_path, "geometry_msgs/msg/PoseStamped", POSE_STAMPED, content)
    text = "".join(f"{'=' * 80}\nIDL: {name}\n{part}" for name, part in IDL.items())
    schema = dataclasses.replace(raw.channel.schema, encoding="ros2idl", data=text.encode())
    (expected,) = decode(raw, "odometry")
    (record,) = decode(dataclasses.replace(raw, channel=dataclasses.replace(raw.channel, schema=schema)), "odometry")
    assert_same_record(record, expected, tolerance=0.0)


@pytest.mark.parametrize("encoding", ["ros2msg", "ros2idl"])
def test_a_definition_that_cannot_be_read_is_named(tmp_path, encoding):
    content = {"header": header(), "pose": pose()}
    (raw,) = messages(tmp_path, "geometry_msgs/msg/PoseStamped", POSE_STAMPED, content)
    schema = dataclasses.replace(raw.channel.schema, encoding=encoding, data=b"no ][ definition")
    with pytest.raises(InvalidRecordError, match="definition of geometry_msgs/msg/PoseStamped cannot be read"):
        decode(dataclasses.replace(raw, channel=dataclasses.replace(raw.channel, schema=schema)), "odometry")


@needs_nav2
def test_a_real_robot_log():
    with LogReader(NAV2) as reader:
        selection = select_topics(reader.topics(), needed=["odometry"])
        assert selection.topics_of("odometry") == ("/odom",)
        assert selection.topics_of("transforms") == ("/tf", "/tf_static")
        entries = list(reader.records(selection))
        assert reader.counters == {}
        odometry = [e.record for e in entries if e.topic == "/odom"]
        amcl = list(reader.records(Selection.of({"/amcl_pose": "ground_truth"})))
        from_tf = list(reader.records(Selection.of({"/tf": "odometry"})))
    assert len(odometry) == 2639
    assert len(amcl) == 135
    assert len(from_tf) > 1000
    assert [e.log_time_ns for e in entries] == sorted(e.log_time_ns for e in entries)
    assert {o.frame_id for o in odometry} == {"odom"}


@needs_nav2
def test_the_summary_of_a_real_robot_log():
    summary = summarize(NAV2)
    odom = next(topic for topic in summary.topics if topic.topic == "/odom")
    assert (odom.message_count, odom.duplicate_stamps, odom.out_of_order_stamps) == (2639, 0, 0)
    assert odom.rate_hz == pytest.approx(27.28, abs=0.01)
    assert odom.frames == ("base_link", "odom")
    assert summary.odometry_length_m == pytest.approx(34.32, abs=0.01)
    assert summary.selection is None
    assert "no topic gives detections" in summary.obstacle


@needs_nav2
@pytest.mark.parametrize("cut", [200_000, 505_000, 505_390])
def test_a_real_robot_log_cut_short(tmp_path, cut):
    path = tmp_path / "cut.mcap"
    path.write_bytes(NAV2.read_bytes()[:cut])
    with LogReader(path) as reader:
        count = len(list(reader.records(Selection.of({"/odom": "odometry"}))))
        assert count == (2639 if cut > 500_000 else 0)  # it is one chunk
        assert reader.counters.get("lost_bytes", 0) > 0 or count
