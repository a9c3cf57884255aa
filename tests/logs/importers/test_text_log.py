import hashlib
import tracemalloc
import zlib
from pathlib import Path

import numpy as np
import pytest

from logs.errors import DatasetError
from logs.importers.imported_log import write_drive
from logs.importers.text_log import TextLog, read_text_log
from logs.messages import DetectionTruth, GeodeticFix, GroundTruthPose, ObjectDetections, Odometry
from tests.logs.importers.text_drives import DETECTIONS, TUM, TextDrive


@pytest.fixture
def drive(tmp_path: Path) -> TextDrive:
    return TextDrive.make(tmp_path)


def read(drive: TextDrive, **changed: str) -> TextLog:
    return read_text_log(**drive.files(**changed))


def test_records_in_order_of_time(drive: TextDrive) -> None:
    records = list(read(drive).records())
    scan = [Odometry, ObjectDetections, DetectionTruth, GroundTruthPose]
    plain = [Odometry, GroundTruthPose]
    assert [type(record) for record in records] == scan + scan + plain + plain + scan
    assert [record.stamp_ns for record in records[:5]] == [100_000_000_000] * 4 + [100_100_000_000]
    assert (records[1].labels, records[1].frame_id) == (("pole", "tree"), "base_link")
    np.testing.assert_array_equal(records[1].positions, [[1, 2, 3], [4, 5, 6]])
    assert records[2].object_ids == ("7", "")


def test_fixes_of_satellites(drive: TextDrive) -> None:
    drive.write("fixes.csv", "stamp_s,lat,lon,altitude_m,sigma_m\n100.0,60.1,24.9,12,2\n100.2,60.2,24.8,,\n")
    fixes = [record for record in read(drive, gnss="fixes.csv").records() if isinstance(record, GeodeticFix)]
    assert [(fix.stamp_ns, fix.latitude_deg, fix.longitude_deg, fix.altitude_m) for fix in fixes] == [
        (100_000_000_000, 60.1, 24.9, 12.0),
        (100_200_000_000, 60.2, 24.8, 0.0),
    ]
    np.testing.assert_array_equal(fixes[0].covariance, 4.0 * np.eye(3))
    assert fixes[1].covariance is None


@pytest.mark.parametrize("row", ["100.0,90.5,24.9", "100.0,60.1,-181", "100.0,,24.9"])
def test_fixes_outside_of_the_earth_are_refused(drive: TextDrive, row: str) -> None:
    drive.write("fixes.csv", f"stamp_s,latitude_deg,longitude_deg\n{row}\n")
    with pytest.raises(DatasetError, match=r"fixes\.csv, line 2, column l\w+_deg"):
        read(drive, gnss="fixes.csv")


def test_source_has_names_without_folders(drive: TextDrive) -> None:
    log = read(drive)
    assert (log.odometry.format, log.odometry.length_m, log.notes) == ("tum", 4.0, ())
    assert log.source["detections"] == "detections.csv"
    assert log.source["detections_sha256"] == hashlib.sha256(DETECTIONS.encode()).hexdigest()


def test_packed_files_give_same_records(drive: TextDrive) -> None:
    drive.write("odometry.tum.gz", TUM)
    drive.write("detections.csv.gz", "\ufeff" + DETECTIONS.replace("\n", "\r\n"))
    packed = read(drive, odometry="odometry.tum.gz", detections="detections.csv.gz")
    written = []
    for log in (read(drive), packed, packed):
        write_drive(drive.output, log.records(), {})
        written.append(drive.output.read_bytes())
    assert written[0] == written[1] == written[2]


def test_damaged_gzip_is_refused(drive: TextDrive) -> None:
    path = drive.write("odometry.tum.gz", TUM)
    path.write_bytes(path.read_bytes()[:-9])
    with pytest.raises(DatasetError, match=r"odometry\.tum\.gz: cannot be unpacked .*again"):
        read(drive, odometry="odometry.tum.gz")


@pytest.mark.slow
def test_gzip_bomb_is_refused_before_it_fills_memory(drive: TextDrive) -> None:
    path = drive.write("odometry.tum.gz", TUM)
    packed = zlib.compressobj(9, wbits=31)
    zeros = bytes(1_000_000)
    path.write_bytes(b"".join([*(packed.compress(zeros) for _ in range(300)), packed.flush()]))
    tracemalloc.start()
    with pytest.raises(DatasetError, match=r"odometry\.tum\.gz: its \d+ bytes unpack to more than 64 MB"):
        read(drive, odometry="odometry.tum.gz")
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 200e6


@pytest.mark.parametrize(
    ("detections", "note"),
    [
        ("stamp_s,x_m,y_m,yaw\n100,1,2,0.5\n", "1 of 1 detections have no label and are of the class object"),
        ("stamp_s,label,x_m,y_m,frame\n100,a,1,2,lidar\n100,a,1,2,\n", "detections are in lidar"),
    ],
)
def test_notes_about_detections(drive: TextDrive, detections: str, note: str) -> None:
    drive.write("detections.csv", detections)
    log = read(drive)
    assert note in log.notes[0]
    assert log.detections.left_out == (("yaw",) if "yaw" in detections else ())


def test_note_about_kitti_poses_without_calibration(drive: TextDrive) -> None:
    drive.write("poses.txt", "".join(f"1 0 0 {i} 0 1 0 0 0 0 1 0\n" for i in range(5)))
    drive.write("times.txt", "".join(f"{100 + 0.1 * i:.3f}\n" for i in range(5)))
    assert "give --calib" in read(drive, odometry="poses.txt", times="times.txt").notes[0]
