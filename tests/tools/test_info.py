"""dslam info: detections that cannot be placed, and maps without a trajectory."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from logs.messages import ObjectDetections, Odometry, Transform
from logs.summary import summarize
from logs.writer import LogWriter
from slam.place_recognition.imported_map import make_imported_map, save_imported_map
from tests.tools.runs import Run
from tools.inspection.frames import find_faults, list_edges


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


def test_info_of_a_map_of_a_fleet_counts_its_landmarks_and_has_no_duration(dslam: Run, tmp_path: Path) -> None:
    positions = np.array([[0.0, 0.0, 0.0], [9.0, 0.0, 0.0], [0.0, 9.0, 0.0], [9.0, 9.0, 0.0]])
    tiles = make_imported_map(positions, ["tree", "pole", "tree", "tree"], list("abcd"), sigma_m=0.3)
    seen = replace(tiles.objects, stamp_ns=1_700_000_000_000_000_000)
    save_imported_map(tmp_path / "map.mcap", tiles, seen)
    lines = dslam("info", tmp_path / "map.mcap").out.splitlines()
    assert any(line.split() == ["landmarks", "tree", "3,", "pole", "1"] for line in lines)
    assert lines[0].startswith(f"{tmp_path / 'map.mcap'}: 0.0 s")


def test_pairs_of_frames(tmp_path: Path) -> None:
    log = write_drive(tmp_path / "log.mcap")
    assert list_edges(summarize(log).topics) == ["base_link -> lidar  (/tf_static)", "odom -> base_link  (/odom)"]
