"""Drives are mapped and evaluated, with faults where they are asked for."""

from pathlib import Path

import pytest

from slam.common.config import Config
from slam.sweeps import mapped_drive
from slam.sweeps.mapped_drive import DriveTask, map_drive
from tests.logs.importers.text_drives import TextDrive
from tools.lab.commands.robots import map_robot

pytestmark = pytest.mark.slow


def test_faults_are_applied_to_the_drive_and_its_truth(short_log: Path) -> None:
    tasks = [DriveTask(short_log, Config(), faults) for faults in ("", "heading_jump=90", "lengths_scaled=20")]
    clean, turned, scaled = map(map_drive, tasks)
    assert not clean.error + turned.error + scaled.error
    assert clean.figure("trajectory.ate_m") < 0.5
    odometry_m = clean.figure("trajectory.odometry_ate_m")
    assert turned.figure("trajectory.odometry_ate_m") > 10 * odometry_m
    assert scaled.figure("trajectory.odometry_ate_m") == pytest.approx(20.0 * odometry_m, rel=1e-3)
    assert clean.peak_memory_bytes > 1e7
    assert clean.figure("no.such.figure") is None


def test_failure_is_a_result(short_log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    assert "no_such_fault" in map_drive(DriveTask(short_log, Config(), "no_such_fault")).error

    def fail(*_: object, **__: object) -> None:
        raise ZeroDivisionError("broken")

    monkeypatch.setattr(mapped_drive, "replay", fail)
    failed = map_drive(DriveTask(short_log, Config()))
    assert failed.error == "this should not happen: ZeroDivisionError: broken"
    assert not list(tmp_path.iterdir())


def test_robot_is_imported_and_mapped(tmp_path: Path) -> None:
    files = TextDrive.make(tmp_path).files()
    files["ground_truth"].rename(tmp_path / "groundtruth.tum")
    run = map_robot(tmp_path, Config())
    assert run.error == ""
    assert run.figure("trajectory.ate_m") == pytest.approx(0.0, abs=1e-6)
    # One object, in three of the four detections, and a false positive; nothing is ever met again.
    assert (run.figure("associations.detection_count"), run.figure("associations.possible_count")) == (4, 2)
    assert run.figure("associations.precision") == 1.0
    assert (run.figure("closures.accepted_count"), run.figure("closures.recall")) == (0, None)
    assert run.log_s == pytest.approx(0.4)
    assert run.reported[0].startswith("not corrected")


def test_broken_files_of_a_robot_are_a_result(tmp_path: Path) -> None:
    TextDrive.make(tmp_path).write("odometry.tum", "nothing\n")
    assert "odometry.tum: no column for the stamp" in map_robot(tmp_path, Config()).error
    (tmp_path / "detections.csv").unlink()
    assert "no file odometry.* or detections.*" in map_robot(tmp_path, Config()).error
