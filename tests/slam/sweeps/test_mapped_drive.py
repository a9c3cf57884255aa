"""Drives are mapped in processes of their own and evaluated, with faults where they are asked for."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from slam.common.config import Config
from slam.sweeps import mapped_drive
from slam.sweeps.mapped_drive import DriveTask, map_drive, map_drives
from tests.helpers.short_drives import Entry, keep_until, write_log
from tests.logs.importers.text_drives import TextDrive
from tools.lab.commands.robots import map_robot
from tools.lab.drives.robot_drives import RobotDrive, find_drives

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def log(noisy_drive: list[Entry], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_log(tmp_path_factory.mktemp("tiny") / "tiny.mcap", keep_until(noisy_drive, 5.0))


def task(log: Path, folder: Path, *faults: str) -> DriveTask:
    return DriveTask(", ".join(faults), log, Config(), folder, faults=faults)


def test_faults_are_applied_to_the_drive_and_its_truth(log: Path, tmp_path: Path) -> None:
    faults = ([], ["heading_jump=90"], ["lengths_scaled=20"])
    clean, turned, scaled = map_drives([task(log, tmp_path, *each) for each in faults])
    assert not clean.error + turned.error + scaled.error
    assert clean.figure("trajectory.ate_m") < 0.5
    odometry_m = clean.figure("trajectory.odometry_ate_m")
    assert turned.figure("trajectory.odometry_ate_m") > 10 * odometry_m
    assert scaled.figure("trajectory.odometry_ate_m") == pytest.approx(20.0 * odometry_m, rel=1e-3)
    assert clean.summary.counters["odometry_used"] > 0
    assert clean.peak_memory_bytes > 1e7


def test_drive_without_truth_has_undefined_figures(log: Path, tmp_path: Path, noisy_drive: list[Entry]) -> None:
    kept = [entry for entry in keep_until(noisy_drive, 1.0) if not entry[0].startswith("/ground_truth")]
    run = map_drive(task(write_log(tmp_path / "log.mcap", kept), tmp_path))
    assert run.error == ""
    assert (
        run.figure("trajectory.ate_m")
        is run.figure("closures.precision")
        is run.figure("associations.object_count")
        is None
    )


def test_failure_is_a_result(log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert "no_such_fault" in map_drive(task(log, tmp_path, "no_such_fault")).error

    def fail(*_: object, **__: object) -> None:
        raise ZeroDivisionError("broken")

    monkeypatch.setattr(mapped_drive, "replay", fail)
    assert map_drive(task(log, tmp_path)).error == "this should not happen: ZeroDivisionError: broken"
    assert not list(tmp_path.iterdir())


def die(_: DriveTask) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def test_death_of_the_process_is_a_result(log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mapped_drive, "map_drive", die)
    (run,) = map_drives([task(log, tmp_path, "labels_unique")])
    assert f"exit code {-signal.SIGKILL}" in run.error


def test_robot_is_imported_and_mapped(tmp_path: Path) -> None:
    files = TextDrive.make(tmp_path).files()
    run = map_robot(RobotDrive("a", files["odometry"], files["detections"], files["ground_truth"]), Config())
    assert run.error == ""
    assert run.figure("trajectory.odometry_ate_m") == pytest.approx(0.0, abs=1e-6)
    assert run.figure("trajectory.ate_m") == pytest.approx(0.0, abs=1e-6)
    # One object and a false positive; nothing is ever met again.
    assert (run.figure("associations.object_count"), run.figure("associations.precision")) == (1, 1.0)
    assert (run.figure("closures.accepted_count"), run.figure("closures.recall")) == (0, None)
    assert run.summary.log_s == pytest.approx(0.4)
    assert run.summary.final_status.startswith("not corrected")


def test_broken_files_of_a_robot_are_a_result(tmp_path: Path) -> None:
    TextDrive.make(tmp_path).write("odometry.tum", "nothing\n")
    (broken,) = find_drives(tmp_path)
    assert "odometry.tum has no rows" in map_robot(broken, Config()).error
    assert "no file detections.*" in map_robot(RobotDrive("c", tmp_path / "odometry.tum", None, None), Config()).error
