import logging
import math
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from logs.decoders.decode import decode
from logs.errors import InvalidRecordError
from logs.reader import LogReader
from logs.schemas import dslam_pb2 as pb
from logs.selection import Selection
from logs.topics import Channel, RawMessage, Schema
from logs.validation import ROTATION_TOLERANCE, is_rotation, rotation_errors
from logs.writer import LogWriter


def raw(message):
    schema = Schema(message.DESCRIPTOR.full_name, "protobuf", b"")
    return RawMessage(Channel("/topic", "protobuf", schema), 77, 77, 0, message.SerializeToString())


def pose(x=0.0, qx=0.0, qy=0.0, qz=0.0, qw=1.0):
    message = PoseInFrame(frame_id="odom")
    message.pose.position.x = x
    q = message.pose.orientation
    q.x, q.y, q.z, q.w = qx, qy, qz, qw
    return raw(message)


@pytest.mark.parametrize(
    ("fields", "reason"),
    [
        ({"x": math.nan}, "position is not finite"),
        ({"x": 2e9}, "position is out of range"),
        ({"qx": math.nan}, "quaternion is not a rotation"),
        ({"qw": 1.02}, "quaternion is not a rotation"),
    ],
)
def test_poses_that_are_none_are_refused(fields, reason):
    with pytest.raises(InvalidRecordError, match=r"/topic at 77 ns: ") as caught:
        decode(pose(**fields), "odometry")
    assert caught.value.reason == reason


def test_one_matrix_is_judged_as_many_are():
    rng = np.random.default_rng(0)
    R = Rotation.random(500, rng).as_matrix() * rng.choice([1.0, 1.0, -1.0], (500, 1, 1))
    R += rng.uniform(-1.0, 1.0, R.shape) * 2e-3 * (rng.random(R.shape) < 0.2)
    expected = rotation_errors(R) <= ROTATION_TOLERANCE
    assert 100 < expected.sum() < 400
    assert [is_rotation(each) for each in R.tolist()] == expected.tolist()


@given(
    st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: np.linalg.norm(q) > 0.1),
    st.floats(0.991, 1.009),
)
def test_rounded_quaternions_are_normalised(q, scale):
    q = np.array(q) / np.linalg.norm(q) * scale
    (record,) = decode(pose(qx=q[0], qy=q[1], qz=q[2], qw=q[3]), "odometry")
    R = record.T_odom_body[:3, :3]
    np.testing.assert_allclose(R, Rotation.from_quat(q).as_matrix(), atol=1e-14)
    np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-15 * 4)


def test_objects_without_a_position_are_dropped_and_counted():
    message = pb.ObjectDetections(
        stamp_ns=1,
        frame_id="lidar",
        positions=[0, 0, 0, math.nan, 0, 0, 1, 1, 2e9, 2, 2, 2],
        labels=["a", "b", "c", "d"],
        scores=[0.5, 0.5, 0.5, 7.0],
        covariances=np.tile(np.eye(3), (4, 1, 1)).ravel().tolist(),
    )
    counters = Counter()
    (record,) = decode(raw(message), "detections", counters)
    assert counters == {"dropped_objects": 2}
    assert record.labels == ("a", "d")
    np.testing.assert_array_equal(record.positions, [[0, 0, 0], [2, 2, 2]])
    np.testing.assert_array_equal(record.scores, [0.5, 1.0])
    assert record.covariances.shape == (2, 3, 3)


@pytest.mark.parametrize("change", [{"labels": ["a", "b", "c"]}, {"covariances": [1.0]}])
def test_detections_whose_lengths_disagree_are_refused(change):
    fields = {"positions": [0.0] * 12, "labels": ["a"] * 4, "scores": [1.0] * 4, **change}
    with pytest.raises(InvalidRecordError, match="lengths disagree"):
        decode(raw(pb.ObjectDetections(stamp_ns=1, **fields)), "detections")


@pytest.mark.parametrize("first", [2.0, -1.0])
def test_stored_matrix_that_is_no_rotation_is_refused(first):
    message = pb.Trajectory(stamp_ns=1, stamps_ns=[1], map_body=[first, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0])
    with pytest.raises(InvalidRecordError, match="not a rotation"):
        decode(raw(message), "trajectory")


def test_bytes_that_are_no_message_are_refused():
    good = pose()
    bad = RawMessage(good.channel, 5, 5, 0, b"\xff\xff\xff")
    with pytest.raises(InvalidRecordError, match="bytes do not decode"):
        decode(bad, "odometry")


def test_the_reader_counts_invalid_messages_and_tells_each_reason_once(tmp_path, caplog):
    on_odom = replace(pose().channel, topic="/odom")
    with LogWriter(tmp_path / "log.mcap") as writer:
        for i in range(10):
            writer.write_raw(replace(pose(math.nan if i % 2 else 1.0), channel=on_odom, log_time_ns=i + 1))
    with LogReader(tmp_path / "log.mcap") as reader, caplog.at_level(logging.WARNING):
        for _ in range(2):
            found = [entry.record.stamp_ns for entry in reader.records(Selection.of({"/odom": "odometry"}))]
            assert found == [1, 3, 5, 7, 9]
            assert reader.counters == {"invalid_messages": 5}
    assert len(caplog.records) == 1
    assert "/odom at 2 ns: position is not finite" in caplog.text


@pytest.mark.parametrize("stamp_ns", [-1, 2**62, 2**63 - 1])
def test_stamps_before_zero_and_after_the_next_century_are_refused(stamp_ns):
    with pytest.raises(InvalidRecordError, match="time out of range"):
        decode(raw(pb.ObjectDetections(stamp_ns=stamp_ns)), "detections")
    with pytest.raises(InvalidRecordError, match="time out of range"):
        decode(raw(pb.Trajectory(stamp_ns=1, stamps_ns=[stamp_ns], map_body=np.eye(4)[:3].ravel())), "trajectory")
