from __future__ import annotations

import tarfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from logs.clouds.class_names import SEMANTIC_KITTI_OBJECTS
from logs.clouds.objects import CloudObjects, find_objects
from logs.clouds.semantic_kitti import read_semantic_kitti, read_semantic_kitti_scan
from logs.errors import DatasetError
from logs.importers.imported_log import ImportSummary, write_imported_log
from logs.messages import FloatArray, GroundTruthPose, ObjectDetections, Odometry
from logs.reader import LogReader
from logs.selection import select_topics
from tests.helpers.data import KITTI, SCANS, needs_scans
from tests.logs.clouds.clouds import post

R_CAMERA_VELODYNE = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
STEP_M = 1.0
COUNT = 5


@dataclass
class Sequence:
    """Scans of posts along a street that winds, driven 1 m a scan."""

    root: Path

    def __post_init__(self) -> None:
        for folder in ("velodyne", "labels"):
            (self.root / folder).mkdir()
        poles = [(6.0 * i + (i % 3), (-1) ** i * (4.0 + i % 2)) for i in range(-2, 8)]
        yaws = 0.1 * np.sin(0.7 * np.arange(COUNT))
        bodies = np.tile(np.eye(4), (COUNT, 1, 1))
        bodies[:, :2, :2] = np.moveaxis(np.array([[np.cos(yaws), -np.sin(yaws)], [np.sin(yaws), np.cos(yaws)]]), 2, 0)
        bodies[1:, 0, 3] = STEP_M * np.arange(1, COUNT)
        for i, T_odom_body in enumerate(bodies):
            points = np.concatenate([self._seen(T_odom_body, x, y) for x, y in poles])
            points = np.concatenate([points, [[60.0, 0.0, 0.0]] * 20])
            tags = np.append(np.full(len(points) - 20, 80), [40] * 20).astype("<u4")
            np.column_stack([points, np.zeros(len(points))]).astype("<f4").tofile(self.root / f"velodyne/{i:06d}.bin")
            tags.tofile(self.root / f"labels/{i:06d}.label")
        T_camera_velodyne = np.eye(4)
        T_camera_velodyne[:3, :3] = R_CAMERA_VELODYNE
        numbers = " ".join(f"{v:.9f}" for v in T_camera_velodyne[:3].ravel())
        (self.root / "calib.txt").write_text(f"Tr: {numbers}\n")
        cameras = T_camera_velodyne @ bodies @ np.linalg.inv(T_camera_velodyne)
        np.savetxt(self.root / "poses.txt", cameras[:, :3].reshape(-1, 12))
        np.savetxt(self.root / "times.txt", 0.1 * np.arange(COUNT), fmt="%.6f")

    @staticmethod
    def _seen(T_odom_body: FloatArray, x_m: float, y_m: float) -> FloatArray:
        place = np.linalg.inv(T_odom_body) @ [x_m, y_m, 0.0, 1.0]
        return post(float(place[0]), float(place[1]), height_m=2.0)


def write(output: Path, root: Path, ground_truth: Path | None = None) -> ImportSummary:
    drive = read_semantic_kitti(root, ground_truth=ground_truth)
    return write_imported_log(output, drive.records(), drive.drive.source)


@pytest.fixture
def sequence(tmp_path: Path) -> Sequence:
    return Sequence(tmp_path)


def test_each_scan_gives_odometry_objects_and_truth(sequence: Sequence) -> None:
    output = sequence.root / "out.mcap"
    summary = write(output, sequence.root, sequence.root / "poses.txt")
    assert summary.message_counts == {"/odom": COUNT, "/detections": COUNT, "/ground_truth": COUNT}
    with LogReader(output) as reader:
        records = [entry.record for entry in reader.records(select_topics(reader.topics()))]
        assert reader.metadata()["source"]["dataset"] == "semantic-kitti"
    assert [type(record) for record in records[:3]] == [Odometry, ObjectDetections, GroundTruthPose]
    moved = [r.T_odom_body[0, 3] for r in records if isinstance(r, Odometry)]
    np.testing.assert_allclose(moved, STEP_M * np.arange(COUNT), atol=1e-9)
    first = next(r for r in records if isinstance(r, ObjectDetections))
    assert set(first.labels) == {"pole"}
    assert np.linalg.norm(first.positions[:, :2] - [0.0, 4.0], axis=1).min() < 0.1


def test_labels_shorter_than_their_scan_are_told(sequence: Sequence) -> None:
    path = sequence.root / "labels/000002.label"
    path.write_bytes(path.read_bytes()[:-8])
    with pytest.raises(DatasetError, match=r"000002.label: \d+ labels, but 000002.bin has \d+ points"):
        write(sequence.root / "out.mcap", sequence.root)


def test_files_that_are_missing_or_cut_off_are_told(sequence: Sequence) -> None:
    path = sequence.root / "velodyne/000002.bin"
    path.write_bytes(path.read_bytes()[:-3])
    with pytest.raises(DatasetError, match=r"000002.bin: .* it is truncated"):
        write(sequence.root / "out.mcap", sequence.root)
    path.unlink()
    (sequence.root / "labels/000004.label").unlink()
    with pytest.raises(DatasetError, match=r"000004.label: cannot be read"):
        write(sequence.root / "out.mcap", sequence.root)


def test_poses_and_times_must_be_as_many_and_enough(sequence: Sequence) -> None:
    times = sequence.root / "times.txt"
    times.write_text("0.0\n0.1\n")
    with pytest.raises(DatasetError, match=f"2 times in times.txt, {COUNT} poses in"):
        write(sequence.root / "out.mcap", sequence.root)
    (sequence.root / "poses.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n" * 2)
    with pytest.raises(DatasetError, match=r"000002.bin: there are only 2 poses"):
        write(sequence.root / "out.mcap", sequence.root)


def real_objects(name: str) -> CloudObjects:
    cloud = read_semantic_kitti_scan(SCANS / f"{name}.bin", SCANS / f"{name}.label")
    return find_objects(cloud, SEMANTIC_KITTI_OBJECTS, viewpoint=np.zeros(3))


@needs_scans
def test_objects_of_real_scans_are_those_that_were_published() -> None:
    with tarfile.open(KITTI / "gosmatch_00.tar.xz") as archive:

        def lines(name: str) -> list[str]:
            member = archive.extractfile(f"00/{name}")
            assert member is not None
            return member.read().decode().split("\n")

        counts = lines("bow.txt")
        for name in ("000052", "004501"):
            vehicles, trunks, poles = (int(n) for n in counts[int(name)].split(","))
            centroids = np.array([[float(v) for v in line.split()] for line in lines(f"centroids/{name}.txt") if line])
            objects = real_objects(name)
            published = {"trunk": centroids[vehicles : vehicles + trunks], "pole": centroids[-poles:]}
            for label, theirs in published.items():
                ours = objects.positions[[found == label for found in objects.labels]]
                apart = np.linalg.norm(theirs[:, None] - ours[None], axis=2)
                assert np.mean(apart.min(axis=1) < 0.5) >= 0.9
                assert np.mean(apart.min(axis=0) < 0.5) >= 0.9


def test_scans_may_be_left_out(sequence: Sequence) -> None:
    (sequence.root / "velodyne/000003.bin").unlink()
    summary = write(sequence.root / "out.mcap", sequence.root)
    assert summary.message_counts == {"/odom": COUNT - 1, "/detections": COUNT - 1}
