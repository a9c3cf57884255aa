"""Replays of ROS 2 recordings: where each detection is, by its own frame and the transforms at its stamp."""

from pathlib import Path

import numpy as np
import pytest

from logs.messages import GroundTruthPose, ObjectDetections, Odometry
from slam.common.config import Config
from slam.common.geometry import apply, invert, transform_from_xyz_yaw
from slam.evaluation.evaluate import evaluate
from slam.evaluation.inputs.records import read_records
from slam.replay import replay
from tests.helpers.ros2_logs import Message, detections3d, header, ros2_messages, tf, write_bag
from tests.helpers.short_drives import drive, keep_until

SECONDS = 25.0


def T_body_mast(stamp_ns: int) -> np.ndarray:
    """A sensor that swings by 1 rad/s, told at 5 Hz: a straight line between the times at which it is told."""
    seconds = stamp_ns * 1e-9
    return transform_from_xyz_yaw(np.array([0.3, 0.0, 1.2]), abs(seconds % 2.0 - 1.0))


def swinging() -> list[Message]:
    """A drive whose sensor swings; only the detections themselves name its frame."""
    entries = keep_until(drive(), SECONDS)
    found: list[Message] = []
    for topic, log_time_ns, record in entries:
        if isinstance(record, ObjectDetections):
            moved = apply(invert(T_body_mast(record.stamp_ns)), record.positions)
            values = detections3d(ObjectDetections(record.stamp_ns, "mast", moved, record.labels, record.scores))
            for detection in values["detections"]:
                detection["header"] = values["header"]
            values["header"] = header(record.stamp_ns, "")
            found.append(("/detections", "vision_msgs/msg/Detection3DArray", log_time_ns, values))
        elif isinstance(record, (Odometry, GroundTruthPose)):
            found += ros2_messages([(topic, log_time_ns, record)])
    first_ns, last_ns = found[0][2], found[-1][2]
    for time_ns in range(first_ns - first_ns % 10**9, last_ns + 10**9, 2 * 10**8):
        told = {"transforms": [tf(time_ns, "base_link", "mast", T_body_mast(time_ns))]}
        found.append(("/tf", "tf2_msgs/msg/TFMessage", time_ns, told))
    return sorted(found, key=lambda message: message[2])


@pytest.mark.slow
def test_a_swinging_sensor_is_followed(tmp_path: Path) -> None:
    output = tmp_path / "out.mcap"
    summary = replay(write_bag(tmp_path / "bag", swinging()), output, Config(calibrate=False))
    trajectory = evaluate(read_records(output)).estimate
    assert trajectory.ate_m < 0.01
    assert summary.counters["detections_used"] > 200
    assert "detections_without_transform" not in summary.counters
