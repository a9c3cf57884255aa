"""dslam info: detections that cannot be placed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from logs.messages import ObjectDetections, Odometry, Transform
from logs.summary import summarize
from logs.writer import LogWriter
from tools.inspection.frames import draw_tree, find_faults


def write_drive(path: Path, *, sensor: str = "/lidar", delay_ns: int = 0, mount: str = "base_link") -> Path:
    with LogWriter(path) as log:
        log.write("/tf_static", Transform(0, mount, "lidar", np.eye(4)))
        for stamp_ns in range(0, 10**9, 10**8):
            log.write("/odom", Odometry(stamp_ns, np.eye(4)))
            at_ns = stamp_ns + delay_ns
            log.write("/objects", ObjectDetections(at_ns, sensor, np.ones((1, 3)), ("tree",), np.ones(1)), stamp_ns)
    return path


@pytest.mark.parametrize(
    ("changes", "fault"),
    [
        ({}, ""),
        ({"sensor": "odom"}, ""),  # an Odometry message is an edge
        ({"sensor": "camera"}, "/objects is in the frame camera, which no transform connects with base_link"),
        ({"mount": "torso"}, "/objects is in the frame lidar, which no transform connects with base_link"),
        ({"delay_ns": 10**15}, "/objects and /odom are 999999.1 s apart: not on one clock"),
    ],
)
def test_find_faults_names_frames_and_clocks(tmp_path: Path, changes: dict[str, object], fault: str) -> None:
    assert find_faults(summarize(write_drive(tmp_path / "log.mcap", **changes))) == ([fault] if fault else [])


def test_tree_of_frames(tmp_path: Path) -> None:
    log = write_drive(tmp_path / "log.mcap", sensor="camera", mount="base_link")
    assert draw_tree(summarize(log).topics) == [
        "camera",
        "odom",
        "  base_link  (/odom)",
        "    lidar  (/tf_static)",
    ]
