from __future__ import annotations

import hashlib
import tracemalloc
import zlib
from pathlib import Path

import numpy as np
import pytest

from logs.errors import DatasetError
from logs.importers.imported_log import ImportSummary, write_imported_log
from logs.importers.text_log import read_text_log
from logs.messages import DetectionTruth, GroundTruthPose, ObjectDetections, Odometry
from tests.logs.importers.text_drives import DETECTIONS, TUM, TextDrive


def write(output: Path, files: dict[str, Path]) -> ImportSummary:
    log = read_text_log(**files)  # type: ignore[arg-type]
    return write_imported_log(output, log.records(), log.source)


@pytest.fixture
def drive(tmp_path: Path) -> TextDrive:
    return TextDrive.make(tmp_path)


def test_records_come_in_the_order_of_time_and_rows_of_one_stamp_are_one_scan(drive: TextDrive) -> None:
    records = list(read_text_log(**drive.files()).records())
    scan = [Odometry, ObjectDetections, DetectionTruth, GroundTruthPose]
    plain = [Odometry, GroundTruthPose]
    assert [type(record) for record in records] == scan + scan + plain + plain + scan
    assert [record.stamp_ns for record in records[:5]] == [100_000_000_000] * 4 + [100_100_000_000]
    assert isinstance(records[1], ObjectDetections)
    assert records[1].labels == ("pole", "tree")
    assert records[1].frame_id == "base_link"
    np.testing.assert_array_equal(records[1].positions, [[1, 2, 3], [4, 5, 6]])
    assert isinstance(records[2], DetectionTruth)
    assert records[2].object_ids == ("7", "")


def test_log_names_its_files_without_folders(drive: TextDrive) -> None:
    summary = write(drive.output, drive.files())
    log = read_text_log(**drive.files())
    assert summary.message_counts == {
        "/odom": 5, "/detections": 3, "/ground_truth/detections": 3, "/ground_truth": 5
    }  # fmt: skip
    assert (log.odometry.format, log.odometry.length_m, log.notes) == ("tum", 4.0, ())
    assert log.source["detections"] == "detections.csv"
    assert log.source["detections_sha256"] == hashlib.sha256(DETECTIONS.encode()).hexdigest()
    assert not any(str(drive.root) in value for value in log.source.values())


def test_packed_files_give_the_same_records_and_the_same_bytes_each_time(drive: TextDrive) -> None:
    drive.write("odometry.tum.gz", TUM)
    drive.write("detections.csv.gz", DETECTIONS)
    packed = drive.files(odometry="odometry.tum.gz", detections="detections.csv.gz")
    write(drive.output, packed)
    first = drive.output.read_bytes()
    write(drive.output, packed)
    assert drive.output.read_bytes() == first
    plain, unpacked = (list(read_text_log(**files).records()) for files in (drive.files(), packed))
    for a, b in zip(plain, unpacked, strict=True):
        assert (type(a), a.stamp_ns) == (type(b), b.stamp_ns)


@pytest.mark.parametrize("content", [DETECTIONS.replace("\n", "\r\n"), "\ufeff" + DETECTIONS])
def test_line_ends_of_windows_and_a_byte_order_mark_change_nothing(drive: TextDrive, content: str) -> None:
    plain = read_text_log(**drive.files())
    (drive.root / "detections.csv").write_text(content, encoding="utf-8", newline="")
    found = read_text_log(**drive.files())
    assert found.detections.labels == plain.detections.labels
    np.testing.assert_array_equal(found.detections.positions, plain.detections.positions)


def test_a_damaged_archive_is_refused(drive: TextDrive) -> None:
    path = drive.write("odometry.tum.gz", TUM)
    path.write_bytes(path.read_bytes()[:-9])
    with pytest.raises(DatasetError, match=r"odometry\.tum\.gz: cannot be unpacked .*again"):
        read_text_log(**drive.files(odometry="odometry.tum.gz"))


@pytest.mark.slow
def test_an_archive_that_is_far_larger_inside_is_refused_before_it_fills_the_memory(drive: TextDrive) -> None:
    path = drive.write("odometry.tum.gz", TUM)
    packed = zlib.compressobj(9, wbits=31)
    zeros = bytes(1_000_000)
    path.write_bytes(b"".join([*(packed.compress(zeros) for _ in range(300)), packed.flush()]))
    tracemalloc.start()
    with pytest.raises(DatasetError, match=r"odometry\.tum\.gz: its \d+ bytes unpack to more than 64 MB"):
        read_text_log(**drive.files(odometry="odometry.tum.gz"))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 200e6


def test_stamps_outside_stay_and_are_told(drive: TextDrive) -> None:
    drive.write("detections.csv", DETECTIONS.replace("100.400", "100.402"))
    log = read_text_log(**drive.files())
    assert log.detections.stamps.stamps_ns[-1] == 100_402_000_000
    (note,) = log.notes
    assert "detections.csv, line 5, column stamp_s: 1 of 4 detections" in note


def test_another_clock_is_named_with_both_spans(drive: TextDrive) -> None:
    drive.write("detections.csv", DETECTIONS.replace("100.", "1700000000."))
    with pytest.raises(
        DatasetError,
        match=r"line 2, .* lasts from 100 s to 100\.4 s; give both by one clock",
    ):
        read_text_log(**drive.files())


@pytest.mark.parametrize(("quaternion", "is_told"), [("0 0 0 1", False), ("1 0 0 0", True), ("0.8 0 0 0.6", True)])
def test_quaternions_in_another_order_are_told(drive: TextDrive, quaternion: str, is_told: bool) -> None:
    drive.write("odometry.tum", TUM.replace("0 0 0 1", quaternion))
    assert any("qw qx qy qz" in note for note in read_text_log(**drive.files()).notes) == is_told


def test_a_truth_of_another_time_is_refused(drive: TextDrive) -> None:
    drive.write("truth.tum", TUM.replace("\n100.", "\n900."))
    with pytest.raises(DatasetError, match=r"truth\.tum, line 2, column stamp: .*one clock"):
        read_text_log(**drive.files())


def test_columns_without_a_place_are_named(drive: TextDrive) -> None:
    drive.write("detections.csv", "stamp_s,x_m,y_m,yaw,colour\n100,1,2,0.5,red\n")
    log = read_text_log(**drive.files())
    assert log.detections.left_out == ("yaw", "colour")
    assert log.notes == ("1 of 1 detections have no label and are of the class object",)


def test_a_frame_whose_place_is_unknown_is_told(drive: TextDrive) -> None:
    drive.write("detections.csv", "stamp_s,label,x_m,y_m,frame\n100,a,1,2,lidar\n100,a,1,2,\n")
    log = read_text_log(**drive.files())
    assert [record.frame_id for record in log.records() if isinstance(record, ObjectDetections)] == [
        "lidar", "base_link"
    ]  # fmt: skip
    assert "detections are in lidar" in log.notes[0]
    assert "calibration.detection.assume_body_frame=true" in log.notes[0]


def test_kitti_without_a_calibration_is_told_to_be_the_body(drive: TextDrive) -> None:
    drive.write("poses.txt", "".join(f"1 0 0 {i} 0 1 0 0 0 0 1 0\n" for i in range(5)))
    drive.write("times.txt", "".join(f"{100 + 0.1 * i:.3f}\n" for i in range(5)))
    log = read_text_log(**drive.files(odometry="poses.txt", times="times.txt"))
    assert "give --calib" in log.notes[0]
