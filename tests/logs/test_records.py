"""Records refuse what a program may get wrong, when they are made."""

from typing import Any

import numpy as np
import pytest

from logs import messages as m
from logs.encoders import encode
from logs.errors import InvalidRecordError

SEEN: dict[str, Any] = {
    "stamp_ns": 1,
    "frame_id": "",
    "positions": np.zeros((2, 3)),
    "labels": ("a", "b"),
    "scores": np.ones(2),
}
BROKEN = np.eye(4)
BROKEN[0, 3] = np.nan


@pytest.mark.parametrize(
    ("T_odom_body", "fault"),
    [
        (np.eye(3), r"T_odom_body is float64 \(3, 3\); give a float64 array of shape \(4, 4\)"),
        (np.eye(4).tolist(), "T_odom_body is list"),
        (np.diag([2.0, 2.0, 2.0, 1.0]), "T_odom_body is not a rotation"),
        (np.eye(4) + np.outer(np.eye(4)[3], [5, 0, 0, 0]), "last row"),
        (BROKEN, "T_odom_body is not finite"),
    ],
)
def test_poses(T_odom_body: Any, fault: str) -> None:
    with pytest.raises(InvalidRecordError, match=fault):
        m.Odometry(1, T_odom_body)
    with pytest.raises(InvalidRecordError, match=fault.replace("T_odom_body", "T_parent_child")):
        m.Transform(1, "a", "b", T_odom_body)
    with pytest.raises(InvalidRecordError, match=fault.replace("T_odom_body", "T_world_body")):
        m.GroundTruthPose(1, T_odom_body)


@pytest.mark.parametrize("stamp_ns", [1.5, 2**63])
def test_stamps(stamp_ns: Any) -> None:
    with pytest.raises(InvalidRecordError, match=r"stamp_ns is .*; give a whole number of nanoseconds"):
        m.Odometry(stamp_ns, np.eye(4))


@pytest.mark.parametrize(
    ("changed", "fault"),
    [
        ({"positions": np.zeros((3, 3))}, r"positions .* of shape \(2, 3\)"),
        ({"positions": np.zeros((2, 3), complex)}, "positions is complex128"),
        ({"scores": np.array(["x", "y"])}, "scores is <U1"),
        ({"labels": ["a", "b"]}, "labels is not a tuple of strings"),
        ({"covariances": np.zeros((2, 3))}, r"covariances .* of shape \(2, 3, 3\)"),
        ({"frame_id": None}, "frame_id is None; give a string"),
    ],
)
def test_detections(changed: dict[str, Any], fault: str) -> None:
    with pytest.raises(InvalidRecordError, match=fault):
        m.ObjectDetections(**{**SEEN, **changed})


@pytest.mark.parametrize("record", [None, m.ObjectDetections(**{**SEEN, "labels": ("a", "\ud800")})])
def test_what_cannot_be_written(record: Any) -> None:
    with pytest.raises(InvalidRecordError, match=r"no record|not valid Unicode"):
        encode(record)


def test_arrays_of_other_numbers_and_those_that_cannot_be_written_are_taken() -> None:
    fixed = np.zeros((2, 3), np.float32)
    fixed.setflags(write=False)
    assert m.ObjectDetections(**{**SEEN, "positions": fixed, "scores": np.ones(2, int)}).positions is fixed
    assert m.Odometry(np.int64(1), np.eye(4, dtype=int)).stamp_ns == 1
