"""dslam import csv, as it is typed, and what docs/import.md says of it."""

from pathlib import Path

import pytest

from tests.logs.importers.text_drives import DETECTIONS, TextDrive
from tests.tools.runs import Run, assert_refused, assert_well


@pytest.fixture
def drive(tmp_path: Path) -> TextDrive:
    return TextDrive.make(tmp_path)


def options(drive: TextDrive) -> tuple[object, ...]:
    return tuple(part for role, path in drive.files().items() for part in (f"--{role.replace('_', '-')}", path))


def test_json_and_text_tell_what_is_left_out(dslam: Run, drive: TextDrive) -> None:
    drive.write("detections.csv", DETECTIONS.replace("object_id", "species").replace("100.400,pole", "100.400,"))
    told = dslam("import", "csv", drive.output, *options(drive), "--json").json
    assert told["message_counts"] == {"/odom": 5, "/detections": 3, "/ground_truth": 5}
    assert (told["detection_count"], told["odometry_format"], told["columns_left_out"]) == (4, "tum", ["species"])
    text = assert_well(dslam("import", "csv", drive.output, *options(drive))).text
    for part in ("odometry format tum odometry length m 4", "columns left out species", f"notes {told['notes'][0]}"):
        assert part in text


def test_faults_are_one_line(dslam: Run, drive: TextDrive) -> None:
    drive.write("detections.csv", DETECTIONS.replace("4,5,6", "4,five,6"))
    result = dslam("import", "csv", drive.output, *options(drive))
    assert_refused(result, "detections.csv, line 3, column y_m: 'five' is not a finite number; write it with")
    assert not drive.output.exists()
    assert_refused(dslam("import", "csv", drive.files()["odometry"], *options(drive)), "is the input")
