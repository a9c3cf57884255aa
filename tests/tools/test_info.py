"""dslam info: detections that cannot be placed, and maps without a trajectory."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from logs.messages import Transform
from logs.summary import summarize
from slam.place_recognition.imported_map import make_imported_map, save_imported_map
from tests.tools.runs import Run, write_drive
from tools.inspection.info import find_faults, list_edges


def lidar_on(mount: str) -> tuple[Transform, ...]:
    return (Transform(0, mount, "lidar", np.eye(4)),)


@pytest.mark.parametrize(
    ("changes", "fault"),
    [
        ({"frame_id": "/lidar", "transforms": (*lidar_on("mount"), Transform(0, "base_link", "mount", np.eye(4)))}, ""),
        ({"frame_id": "odom"}, ""),  # an Odometry message is an edge
        ({"frame_id": "camera"}, "is in the frame camera, which no transform connects with base_link"),
        (
            {"frame_id": "/lidar", "transforms": lidar_on("torso")},
            "is in the frame lidar, which no transform connects with base_link",
        ),
        ({"delay_ns": 10**15}, "and /odom are 999997.1 s apart: not on one clock"),
    ],
)
def test_find_faults_names_frames_and_clocks(tmp_path: Path, changes: dict[str, object], fault: str) -> None:
    found = find_faults(summarize(write_drive(tmp_path / "log.mcap", **changes)))
    assert found == ([f"/objects {fault}"] if fault else [])


def test_info_of_a_map_of_a_fleet_counts_its_landmarks_and_has_no_duration(dslam: Run, tmp_path: Path) -> None:
    positions = np.array([[0.0, 0.0, 0.0], [9.0, 0.0, 0.0], [0.0, 9.0, 0.0], [9.0, 9.0, 0.0]])
    tiles = make_imported_map(positions, ["tree", "pole", "tree", "tree"], list("abcd"), sigma_m=0.3)
    seen = replace(tiles.objects, stamp_ns=1_700_000_000_000_000_000)
    save_imported_map(tmp_path / "map.mcap", tiles, seen)
    lines = dslam("info", tmp_path / "map.mcap").out.splitlines()
    assert any(line.split() == ["landmarks", "tree", "3,", "pole", "1"] for line in lines)
    assert lines[0].startswith(f"{tmp_path / 'map.mcap'}: 0.0 s")


def test_pairs_of_frames(tmp_path: Path) -> None:
    log = write_drive(tmp_path / "log.mcap", transforms=lidar_on("base_link"))
    assert list_edges(summarize(log).topics) == ["base_link -> lidar  (/tf_static)", "odom -> base_link  (/odom)"]
