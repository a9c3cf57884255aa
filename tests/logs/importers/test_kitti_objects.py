from __future__ import annotations

import hashlib
import tarfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from logs.errors import DatasetError
from logs.importers.imported_log import ImportSummary, write_imported_log
from logs.importers.kitti_objects import read_kitti_objects
from logs.messages import GroundTruthPose, ObjectDetections, Odometry
from logs.reader import LogReader
from logs.selection import select_topics

TR = "Tr: 0 -1 0 0.1 0 0 -1 0.2 1 0 0 -0.3"
"""Velodyne x forward, y left, z up to camera x right, y down, z forward."""


@dataclass
class Dataset:
    """A made-up sequence "07" of three scans, driven 1 m forward each, in files that a test may damage."""

    root: Path

    def __post_init__(self) -> None:
        self.write("objects/07/bow.txt", "1,0,1\n0,1,0\n0,0,0\n")
        self.write("objects/07/centroids/000000.txt", "1 2 3\n4e0 5 -6.5\n")
        self.write("objects/07/centroids/000001.txt", "7 8 9\n")
        self.write("objects/07/centroids/000002.txt", "")
        self.write("poses.txt", "".join(f"1 0 0 0 0 1 0 0 0 0 1 {z}\n" for z in range(3)))
        self.write("truth.txt", "".join(f"1 0 0 {x} 0 1 0 0 0 0 1 0\n" for x in range(3)))
        self.write("calib.txt", f"P0: {' '.join(['0'] * 12)}\n{TR}\n")
        self.write("times.txt", "0.000000e+00\n1.037359e-01\n4.705816123456789e+02\n")

    def write(self, name: str, text: str) -> None:
        path = self.root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)

    def archive(self, name: str) -> Path:
        path = self.root / name
        with tarfile.open(path, f"w:{path.suffix[1:]}") as archive:  # type: ignore[call-overload]
            # Not in the order of the scans: nothing obliges an archive to that.
            for file in sorted((self.root / "objects").rglob("*.txt"), reverse=True):
                archive.add(file, f"somewhere/else/{file.relative_to(self.root / 'objects').as_posix()}")
        return path

    def files(self, detections: Path | None = None) -> dict[str, Path]:
        return {
            "detections": detections or self.root / "objects",
            "odometry": self.root / "poses.txt",
            "calib": self.root / "calib.txt",
            "times": self.root / "times.txt",
            "ground_truth": self.root / "truth.txt",
        }


def write(output: Path, files: dict[str, Path]) -> ImportSummary:
    drive = read_kitti_objects(**files)  # type: ignore[arg-type]
    return write_imported_log(output, drive.records(), drive.source)


@pytest.fixture
def dataset(tmp_path: Path) -> Dataset:
    return Dataset(tmp_path)


def test_records_come_scan_by_scan_in_the_body_frame(dataset: Dataset) -> None:
    records = list(read_kitti_objects(**dataset.files()).records())
    assert [type(record) for record in records] == [Odometry, ObjectDetections, GroundTruthPose] * 3
    odometry, detections, truth = records[3:6]
    assert isinstance(odometry, Odometry)
    assert isinstance(detections, ObjectDetections)
    assert isinstance(truth, GroundTruthPose)
    # The camera moved along its z, which is forward, so the body moved along its x; the truth moved to the right.
    np.testing.assert_allclose(odometry.T_odom_body[:3, 3], [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(truth.T_world_body[:3, 3], [0, -1, 0], atol=1e-12)
    assert detections.labels == ("trunk",)
    assert detections.frame_id == "base_link"
    assert detections.covariances is None
    np.testing.assert_array_equal(detections.positions, [[7, 8, 9]])


def test_labels_follow_the_counts_and_an_empty_scan_has_no_rows(dataset: Dataset) -> None:
    scans = read_kitti_objects(**dataset.files()).scans
    assert scans.labels == (("vehicle", "pole"), ("trunk",), ())
    np.testing.assert_array_equal(scans.positions[0], [[1, 2, 3], [4, 5, -6.5]])
    assert scans.positions[2].shape == (0, 3)


def test_times_become_exact_nanoseconds(dataset: Dataset) -> None:
    assert read_kitti_objects(**dataset.files()).drive.stamps_ns.tolist() == [0, 103_735_900, 470_581_612_346]


def test_lever_arm_of_the_calibration_enters_a_turn(dataset: Dataset) -> None:
    # The camera turns 90 degrees to the left on the spot, so the velodyne behind it swings about it.
    dataset.write("poses.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n" + "0 0 -1 0 0 1 0 0 1 0 0 0\n" * 2)
    T_odom_body = read_kitti_objects(**dataset.files()).drive.T_odom_body
    np.testing.assert_array_equal(T_odom_body[0], np.eye(4))
    # Camera in the body frame: x = 0.3, y = 0.1, z = 0.2.
    camera_in_body = np.array([0.3, 0.1, 0.2, 1.0])
    np.testing.assert_allclose(T_odom_body[1] @ camera_in_body, camera_in_body, atol=1e-12)
    np.testing.assert_allclose(T_odom_body[1][:3, :3] @ [1, 0, 0], [0, 1, 0], atol=1e-12)


@pytest.mark.parametrize("name", ["objects.tar.xz", "objects.tar.gz"])
def test_archive_and_folder_give_the_same_bytes(dataset: Dataset, name: str) -> None:
    from_folder, from_archive = dataset.root / "a.mcap", dataset.root / "b.mcap"
    summary = write(from_folder, dataset.files())
    assert write(from_archive, dataset.files(dataset.archive(name))) == summary
    assert from_folder.read_bytes() == from_archive.read_bytes()
    assert summary.message_counts == {"/odom": 3, "/detections": 3, "/ground_truth": 3}
    assert (summary.detection_count, summary.duration_s) == (3, pytest.approx(470.581612346))


def test_log_names_its_source_without_folders(dataset: Dataset) -> None:
    output = dataset.root / "out.mcap"
    write(output, dataset.files())
    with LogReader(output) as reader:
        entries = list(reader.records(select_topics(reader.topics())))
        source = reader.metadata()["source"]
    expected = read_kitti_objects(**dataset.files()).records()
    assert [(type(e.record), e.record.stamp_ns) for e in entries] == [(type(r), r.stamp_ns) for r in expected]
    assert (source["odometry"], source["detections"]) == ("poses.txt", "07")
    assert source["odometry_sha256"] == hashlib.sha256((dataset.root / "poses.txt").read_bytes()).hexdigest()
    assert not any(str(dataset.root) in value for value in source.values())


def _write(name: str, text: str) -> Callable[[Dataset], None]:
    return lambda dataset: dataset.write(name, text)


def _remove(name: str) -> Callable[[Dataset], None]:
    return lambda dataset: (dataset.root / name).unlink()


POSE = "1 0 0 0 0 1 0 0 0 0 1 0\n"


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (_write("objects/07/bow.txt", "1,0,1\n0,2,0\n0,0,0\n"), "scan 1: .*000001.txt has 1 centroids, .*counts 2"),
        (_write("objects/07/bow.txt", "1,0,1\n0,1\n0,0,0\n"), "bow.txt, line 2"),
        (_write("objects/07/bow.txt", "1,0,1\n0,-1,0\n0,0,0\n"), "bow.txt, line 2"),
        (_write("objects/07/bow.txt", f"1,0,{'9' * 5000}\n0,1,0\n0,0,0\n"), "bow.txt, line 1"),
        (_write("objects/07/bow.txt", "1,0,1\n0,1,0\n"), "2 scans, centroids holds 3 files; scan 2 has not one"),
        (_write("objects/07/centroids/000002.txt", "\n1 2 x\n"), "000002.txt, line 2: 'x' is not a finite number"),
        (_write("objects/07/centroids/000001.txt", "1 2 nan\n"), "000001.txt, line 1: 'nan' is not a finite"),
        (_write("objects/07/centroids/000001.txt", "1 2\n"), "000001.txt, line 1: 2 values where 3"),
        (_write("objects/07/centroids/1.txt", "1 2 3\n"), "scan 1 has not one line and one file"),
        (_write("objects/08/bow.txt", "1,0,0\n"), "2 sequences where one is needed .07, 08."),
        (_remove("objects/07/centroids/000001.txt"), "scan 1 has not one line and one file"),
        (_remove("objects/07/bow.txt"), "no bow.txt"),
        (_write("poses.txt", POSE * 2), "3 scans in objects, 3 times in times.txt, 2 poses in poses.txt"),
        (_write("poses.txt", POSE * 4), "4 poses in poses.txt"),
        (_write("truth.txt", POSE * 2), "2 poses in truth.txt"),
        (_write("times.txt", "0\n1\n"), "2 times in times.txt"),
        (_write("times.txt", "0\n1\n1\n"), "times.txt, line 3, column stamp_s: 1 occurs twice"),
        (_write("times.txt", "0\none\n2\n"), "times.txt, line 2, column stamp_s: 'one'"),
        (_write("times.txt", "0\n1\ninf\n"), "times.txt, line 3"),
        (_write("times.txt", "-1\n1\n2\n"), "times.txt, line 1"),
        (_write("poses.txt", POSE + "1 0 0 0 0 1 0 0 0 0 1\n" + POSE), "poses.txt, line 2: 11 values where 12"),
        (_write("poses.txt", POSE * 2 + "1 0 0 0 0 1 0 0 0 0 1.002 0\n"), "poses.txt, line 3: not a rotation"),
        (
            _write("poses.txt", POSE * 2 + "1 0 0 0 0 1 0 0 0 0 -1 0\n"),
            "poses.txt, line 3: not a rotation .*det R = -1",
        ),
        (_write("poses.txt", POSE * 2 + "0 " * 12 + "\n"), "poses.txt, line 3: not a rotation"),
        (
            _write("poses.txt", POSE * 2 + "1 0 0 1e308 0 1 0 0 0 0 1 0\n"),
            "poses.txt, line 3: .* m is not finite or too far away",
        ),
        (_write("calib.txt", "P0: 1 2 3\n"), "no line 'Tr:'"),
        (_write("calib.txt", "Tr: 1 2 3\n"), "calib.txt, line 1: 3 values"),
        (_write("calib.txt", "Tr: \N{DEGREE SIGN}\n"), "calib.txt, line 1: 1 values"),
        (_remove("times.txt"), "times.txt: cannot be read"),
    ],
)
def test_damage_is_refused_with_its_place_and_nothing_is_written(
    dataset: Dataset, damage: Callable[[Dataset], None], message: str
) -> None:
    damage(dataset)
    with pytest.raises(DatasetError, match=message):
        write(dataset.root / "out.mcap", dataset.files())
    assert not list(dataset.root.glob("out.mcap*"))


def test_rounding_of_seven_digits_is_made_orthonormal(dataset: Dataset) -> None:
    dataset.write("poses.txt", POSE * 2 + "1 0 0 0 0 0.9999 0 0 0 0 1.0001 0\n")
    R = read_kitti_objects(**dataset.files()).drive.T_odom_body[2, :3, :3]
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)


@pytest.mark.parametrize("name", ["objects.tar.xz", "objects.tar.gz"])
def test_truncated_archive_is_refused(dataset: Dataset, name: str) -> None:
    path = dataset.archive(name)
    path.write_bytes(path.read_bytes()[:-60])
    with pytest.raises(DatasetError, match="cannot be read as an archive"):
        read_kitti_objects(**dataset.files(path))


def test_links_and_paths_that_climb_are_only_names_in_memory(dataset: Dataset) -> None:
    path = dataset.root / "evil.tar"
    with tarfile.open(path, "w") as archive:
        for file in sorted((dataset.root / "objects").rglob("*.txt")):
            archive.add(file, "../" * 3 + str(file.relative_to(dataset.root / "objects")))
        link = tarfile.TarInfo("../../../07/centroids/000003.txt")
        link.type, link.linkname = tarfile.SYMTYPE, "/etc/passwd"
        archive.addfile(link)
    before = sorted(dataset.root.rglob("*"))
    assert len(read_kitti_objects(**dataset.files(path)).drive.stamps_ns) == 3
    assert sorted(dataset.root.rglob("*")) == before


def test_sequence_chooses_among_several(dataset: Dataset) -> None:
    dataset.write("objects/08/bow.txt", "1,0,0\n")
    assert read_kitti_objects(**dataset.files(), sequence="07").scans.sequence == "07"
    with pytest.raises(DatasetError, match="0 sequences named '09'"):
        read_kitti_objects(**dataset.files(), sequence="09")
