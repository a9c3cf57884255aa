"""Drives in text files: each is imported, mapped in a process of its own, and evaluated."""

from __future__ import annotations

from pathlib import Path

import pytest

from slam.common.config import Config
from tests.logs.importers.text_drives import TextDrive
from tools.lab.drives.robot_drives import RobotDrive, find_drives
from tools.lab.drives.robot_runs import run_drives

pytestmark = pytest.mark.slow


def test_figures_are_those_of_the_replay_and_its_evaluation(tmp_path: Path) -> None:
    files = TextDrive.make(tmp_path).files()
    drive = RobotDrive("a", files["odometry"], files["detections"], files["ground_truth"])
    (run,) = run_drives([drive], Config())
    figures = run.figures
    assert figures is not None
    assert run.failure == ""
    assert (figures.odometry_ate_m, figures.ate_m) == (pytest.approx(0.0, abs=1e-6), pytest.approx(0.0, abs=1e-6))
    # One object and a false positive; nothing is ever met again.
    assert (figures.object_count, figures.associations_precision) == (1, 1.0)
    assert (figures.closures_accepted, figures.closures_precision, figures.revisit_recall) == (0, None, None)
    assert (figures.discoveries_independent, figures.discoveries_false_share) == (0, None)
    assert figures.log_s == pytest.approx(0.4)
    assert figures.real_time_factor == pytest.approx(figures.log_s / figures.wall_s)
    assert figures.peak_memory_bytes > 1e7
    assert figures.counters["odometry_used"] == 5
    assert figures.final_status == "optimised"


def test_without_truth_its_figures_are_undefined_and_a_failure_ends_nothing(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        drive = TextDrive.make(tmp_path / name)
        drive.write("detections.csv", "stamp_s,label,x_m,y_m\n100,pole,1,2\n100.1,pole,0,2\n")
    (tmp_path / "a" / "odometry.tum").write_text("nothing\n")
    no_detections = RobotDrive("c", tmp_path / "b" / "odometry.tum", None, None)
    broken, good, empty = run_drives([*find_drives(tmp_path), no_detections], Config())
    assert (broken.drive, broken.figures) == ("a", None)
    assert "odometry.tum, line 1" in broken.failure
    assert good.figures is not None
    assert (good.figures.odometry_ate_m, good.figures.ate_m, good.figures.object_count) == (None, None, None)
    assert (good.figures.associations_precision, good.figures.revisit_recall) == (None, None)
    assert (empty.figures, "no file detections.*" in empty.failure) == (None, True)
