"""Poses and frames in ROS 2 messages, definitions in IDL, and the log of a real robot."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from logs.decoders.decode import decode
from logs.errors import InvalidRecordError
from logs.reader import LogReader
from logs.selection import Selection, select_topics
from logs.topics import RawMessage
from tests.helpers.data import NAV2, needs_nav2
from tests.helpers.poses import pose_at
from tests.helpers.ros2_logs import encoded, header, tf, vector
from tests.logs.examples import assert_same_record

STAMPED, WITH_COVARIANCE = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PoseWithCovarianceStamped"
STAMP_NS = 3_000_000_004
TURNED = {"position": vector(1, 2, 3), "orientation": {"z": 1.0}}


def stamped(**fields: Any) -> RawMessage:
    values = {"header": header(STAMP_NS, "odom"), "pose": TURNED, **fields}
    return encoded(("/topic", STAMPED, 100, values))


def test_pose_stamped() -> None:
    (odometry,), (truth,) = (decode(stamped(), kind) for kind in ("odometry", "ground_truth"))  # type: ignore[arg-type]
    expected = np.diag([-1.0, -1.0, 1.0, 1.0])
    expected[:3, 3] = [1, 2, 3]
    np.testing.assert_array_equal(odometry.T_odom_body, expected)
    np.testing.assert_array_equal(truth.T_world_body, expected)
    assert (odometry.stamp_ns, odometry.frame_id, odometry.child_frame_id) == (STAMP_NS, "odom", "base_link")


def test_unset_stamp_is_log_time_and_one_before_zero_is_refused() -> None:
    (record,) = decode(stamped(header=header(0, "")), "odometry")  # type: ignore[arg-type]
    assert (record.stamp_ns, record.frame_id) == (100, "odom")
    with pytest.raises(InvalidRecordError, match="/topic at 100 ns: negative time"):
        decode(stamped(header={"stamp": {"sec": -1}}), "odometry")  # type: ignore[arg-type]


def test_tf_gives_frames_or_odometry() -> None:
    values = {"transforms": [tf(5, "map", "odom", pose_at(1.0)), tf(5, "odom", "base_link", pose_at(2.0))]}
    raw = encoded(("/tf", "tf2_msgs/msg/TFMessage", 100, values))
    frames = decode(raw, "transforms")  # type: ignore[arg-type]
    assert [(r.parent_frame_id, r.child_frame_id) for r in frames] == [("map", "odom"), ("odom", "base_link")]
    (odometry,) = decode(raw, "odometry")  # type: ignore[arg-type]
    assert odometry.T_odom_body[0, 3] == 2.0


def test_cut_message_is_refused() -> None:
    raw = stamped()
    for length in range(0, len(raw.data), 7):
        with pytest.raises(InvalidRecordError, match="do not decode"):
            decode(replace(raw, data=raw.data[:length]), "odometry")  # type: ignore[arg-type]


def with_definition(encoding: str, text: str) -> RawMessage:
    raw = stamped()
    assert raw.channel.schema is not None
    schema = raw.channel.schema._replace(encoding=encoding, data=text.encode())
    return replace(raw, channel=replace(raw.channel, schema=schema))


IDL = {
    "geometry_msgs/msg/PoseStamped": """#include "std_msgs/msg/Header.idl"
module geometry_msgs { module msg {
  struct PoseStamped { std_msgs::msg::Header header; geometry_msgs::msg::Pose pose; };
}; };
""",
    "std_msgs/msg/Header": """#include "builtin_interfaces/msg/Time.idl"
module std_msgs { module msg { struct Header { builtin_interfaces::msg::Time stamp; string frame_id; }; }; };
""",
    "builtin_interfaces/msg/Time": (
        "module builtin_interfaces { module msg { struct Time { int32 sec; uint32 nanosec; }; }; };\n"
    ),
    "geometry_msgs/msg/Pose": """module geometry_msgs { module msg {
  struct Point { double x; double y; double z; };
  struct Quaternion { double x; double y; double z; double w; };
  struct Pose { geometry_msgs::msg::Point position; geometry_msgs::msg::Quaternion orientation; };
}; };
""",
}


def test_definitions_in_idl() -> None:
    text = "".join(f"{'=' * 80}\nIDL: {name}\n{part}" for name, part in IDL.items())
    (expected,) = decode(stamped(), "odometry")  # type: ignore[arg-type]
    (record,) = decode(with_definition("ros2idl", text), "odometry")  # type: ignore[arg-type]
    assert_same_record(record, expected, tolerance=0.0)


@pytest.mark.parametrize(
    ("encoding", "text", "fault"),
    [
        ("ros2msg", "no ][ definition", "definition of geometry_msgs/msg/PoseStamped cannot be read"),
        ("ros2idl", "no ][ definition", "definition of geometry_msgs/msg/PoseStamped cannot be read"),
        ("ros2msg", "float64 x", "a field has an unexpected type"),
    ],
)
def test_unusable_definition_is_refused(encoding: str, text: str, fault: str) -> None:
    raw = with_definition(encoding, text)
    with pytest.raises(InvalidRecordError, match=fault):
        decode(replace(raw, data=b"\0\1\0\0" + bytes(8)), "odometry")  # type: ignore[arg-type]


@needs_nav2
def test_real_robot_log() -> None:
    with LogReader(NAV2) as reader:
        selection = select_topics(reader.topics(), needed=["odometry"])
        assert selection.topics_of("odometry") == ("/odom",)
        assert selection.topics_of("transforms") == ("/tf", "/tf_static")
        entries = list(reader.records(selection))
        assert reader.counters == {}
        amcl = list(reader.records(Selection.of({"/amcl_pose": "ground_truth"})))
        from_tf = list(reader.records(Selection.of({"/tf": "odometry"})))
    odometry = [e.record for e in entries if e.topic == "/odom"]
    assert (len(odometry), len(amcl), len(from_tf) > 1000) == (2639, 135, True)
    assert [e.log_time_ns for e in entries] == sorted(e.log_time_ns for e in entries)
    assert {o.frame_id for o in odometry} == {"odom"}
