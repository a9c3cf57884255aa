from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest

from logs.errors import DatasetError
from logs.importers.imported_log import DriveSummary, write_drive
from logs.importers.kitti_objects import read_kitti_objects
from logs.messages import GroundTruthPose, ObjectDetections, Odometry
from logs.reader import LogReader

TR = "Tr: 0 -1 0 0.1 0 0 -1 0.2 1 0 0 -0.3"
"""Velodyne x forward, y left, z up to camera x right, y down, z forward."""
FILES = {
    "07/bow.txt": "1,0,1\n0,1,0\n0,0,0\n",
    "07/centroids/000000.txt": "1 2 3\n4e0 5 -6.5\n",
    "07/centroids/000001.txt": "7 8 9\n",
    "07/centroids/000002.txt": "",
    "poses.txt": "".join(f"1 0 0 0 0 1 0 0 0 0 1 {z}\n" for z in range(3)),
    "truth.txt": "".join(f"1 0 0 {x} 0 1 0 0 0 0 1 0\n" for x in range(3)),
    "calib.txt": f"P0: {' '.join(['0'] * 12)}\n{TR}\n",
    "times.txt": "0.000000e+00\n1.037359e-01\n4.705816123456789e+02\n",
}
"""A made-up sequence "07" of three scans, driven 1 m forward each."""
POSE = "1 0 0 0 0 1 0 0 0 0 1 0\n"


@pytest.fixture
def root(tmp_path: Path) -> Path:
    for name, text in FILES.items():
        write(tmp_path, name, text)
    return tmp_path


def write(root: Path, name: str, text: str) -> None:
    (root / name).parent.mkdir(parents=True, exist_ok=True)
    (root / name).write_text(text)


def paths(root: Path) -> dict[str, Path]:
    roles = {"odometry": "poses.txt", "calib": "calib.txt", "times": "times.txt", "ground_truth": "truth.txt"}
    return {role: root / name for role, name in {"detections": "07", **roles}.items()}


def write_log(output: Path, files: dict[str, Path]) -> DriveSummary:
    drive = read_kitti_objects(**files)
    return write_drive(output, drive.records(), drive.source)


def test_records_in_body_frame(root: Path) -> None:
    drive = read_kitti_objects(**paths(root))
    records = list(drive.records())
    assert [type(record) for record in records] == [Odometry, ObjectDetections, GroundTruthPose] * 3
    assert drive.stamps_ns.tolist() == [0, 103_735_900, 470_581_612_346]
    odometry, detections, truth = records[3:6]
    # The camera moved along its z, which is forward, so the body moved along its x; the truth moved to the right.
    np.testing.assert_allclose(odometry.T_odom_body[:3, 3], [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(truth.T_world_body[:3, 3], [0, -1, 0], atol=1e-12)
    assert (detections.labels, detections.frame_id, detections.covariances) == (("trunk",), "base_link", None)
    np.testing.assert_array_equal(detections.positions, [[7, 8, 9]])
    assert [scan.labels for scan in drive.detections] == [("vehicle", "pole"), ("trunk",), ()]
    assert drive.detections[2].positions.shape == (0, 3)


def test_calibration_is_a_lever_arm(root: Path) -> None:
    # The camera turns 90 degrees to the left on the spot, so the velodyne behind it swings about it.
    write(root, "poses.txt", POSE + "0 0 -1 0 0 1 0 0 1 0 0 0\n" * 2)
    T_odom_body = read_kitti_objects(**paths(root)).T_odom_body
    np.testing.assert_array_equal(T_odom_body[0], np.eye(4))
    camera_in_body = np.array([0.3, 0.1, 0.2, 1.0])
    np.testing.assert_allclose(T_odom_body[1] @ camera_in_body, camera_in_body, atol=1e-12)
    np.testing.assert_allclose(T_odom_body[1][:3, :3] @ [1, 0, 0], [0, 1, 0], atol=1e-12)


def test_log_names_its_source(root: Path) -> None:
    summary = write_log(root / "out.mcap", paths(root))
    assert summary.message_counts == {"/odom": 3, "/detections": 3, "/ground_truth": 3}
    assert (summary.detection_count, summary.duration_s) == (3, pytest.approx(470.581612346))
    with LogReader(root / "out.mcap") as reader:
        source = reader.metadata()["source"]
    assert (source["odometry"], source["detections"]) == ("poses.txt", "07")
    assert source["odometry_sha256"] == hashlib.sha256(FILES["poses.txt"].encode()).hexdigest()


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("07/bow.txt", "1,0\n0,1,0\n0,0,0\n", "bow.txt, line 1: 2 values where 3"),
        ("07/bow.txt", "1,1,1\n0,1,0\n0,0,0\n", r"000000.txt has 2 centroids, but .*bow.txt counts"),
        ("07/bow.txt", "3,0,-1\n0,1,0\n0,0,0\n", r"000000.txt has 2 centroids, but .*bow.txt counts"),
        ("07/bow.txt", f"1,0,{'9' * 5000}\n0,1,0\n0,0,0\n", "bow.txt, line 1"),
        ("07/bow.txt", "1,0,1\n0,1,0\n", "2 scans in bow.txt, 3 times in times.txt"),
        ("07/bow.txt", None, "bow.txt: cannot be read"),
        ("07/centroids/000002.txt", "\n1 2 x\n", "000002.txt, line 2, column z: 'x' is not a finite number"),
        ("07/centroids/000001.txt", "1 2\n", "000001.txt, line 1: 2 values where 3"),
        ("07/centroids/000001.txt", None, "000001.txt: cannot be read"),
        ("poses.txt", POSE * 2, "3 scans in bow.txt, 3 times in times.txt, 2 poses in poses.txt"),
        ("truth.txt", POSE * 2, "2 poses in truth.txt"),
        ("times.txt", "", "times.txt has no rows"),
        ("times.txt", "0\n1\n1\n", "times.txt, line 3, column stamp_s: 1 occurs twice"),
        ("times.txt", "-1\n1\n2\n", "times.txt, line 1"),
        ("times.txt", None, "times.txt: cannot be read"),
        ("poses.txt", POSE + "1 0 0 0 0 1 0 0 0 0 1\n" + POSE, "poses.txt, line 2: 11 values where 12"),
        ("poses.txt", POSE * 2 + "1 0 0 0 0 1 0 0 0 0 1.002 0\n", "poses.txt, line 3: not a rotation"),
        ("poses.txt", POSE * 2 + "1 0 0 0 0 1 0 0 0 0 -1 0\n", "poses.txt, line 3: not a rotation"),
        ("poses.txt", POSE * 2 + "1 0 0 1e308 0 1 0 0 0 0 1 0\n", "poses.txt, line 3: .* farther away"),
        ("calib.txt", "P0: 1 2 3\n", "no line 'Tr:'"),
        ("calib.txt", "P0: 1\nTr: 1 2 3\n", "calib.txt, line 2: 3 values"),
    ],
)
def test_damage_is_refused_and_nothing_is_written(root: Path, name: str, text: str | None, message: str) -> None:
    if text is None:
        (root / name).unlink()
    else:
        write(root, name, text)
    with pytest.raises(DatasetError, match=message):
        write_log(root / "out.mcap", paths(root))
    assert not list(root.glob("out.mcap*"))
