"""dslam calibrate, and what uses its file."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import dslam as library
from logs.reader import LogReader
from slam.common.config import Config, load_config
from tests.tools.runs import SAMPLE, Run, assert_refused


@pytest.fixture
def robot(dslam: Run, tmp_path: Path) -> Path:
    path = tmp_path / "robot.toml"
    assert dslam("calibrate", SAMPLE, "-o", path).code == 0
    return path


def test_file_holds_values_with_sigmas_and_evidence(robot: Path) -> None:
    calibration = load_config(calibration=robot).calibration
    assert calibration.is_complete
    assert calibration.evidence["detections"] > 0
    assert calibration == library.calibrate(SAMPLE)


def test_several_logs_are_pooled(dslam: Run) -> None:
    one, two = (json.loads(dslam("calibrate", *logs, "--json").out) for logs in ((SAMPLE,), (SAMPLE, SAMPLE)))
    assert two["calibration"]["evidence"]["scans"] == 2 * one["calibration"]["evidence"]["scans"]
    assert two["calibration"]["detection"]["sensor_range_m"] == pytest.approx(
        one["calibration"]["detection"]["sensor_range_m"], rel=1e-3
    )


def test_replay_uses_the_file_and_estimates_nothing(dslam: Run, robot: Path, tmp_path: Path) -> None:
    output, again = tmp_path / "out.mcap", tmp_path / "same.toml"
    assert dslam("replay", SAMPLE, "-o", output, "--calibration", robot).code == 0
    with LogReader(output) as reader:
        about = reader.metadata()["dslam"]
    assert json.loads(about["estimated"]) == {}
    used = load_config(calibration=robot)
    assert Config.model_validate_json(about["configuration"]) == used
    again.write_text(dslam("config", "--from", output).out)
    assert load_config(again) == used


def test_config_from_a_map_holds_what_was_estimated(dslam: Run, robot: Path, tmp_path: Path) -> None:
    output, same = tmp_path / "out.mcap", tmp_path / "same.toml"
    assert dslam("replay", SAMPLE, "-o", output).code == 0
    same.write_text(dslam("config", "--from", output).out)
    known, estimated = load_config(same).calibration, load_config(calibration=robot).calibration
    assert (known.odometry, known.detection, known.objects) == (
        estimated.odometry, estimated.detection, estimated.objects
    )  # fmt: skip


def test_a_flag_wins_over_the_file_of_the_calibration(robot: Path) -> None:
    config = load_config(None, ["calibration.odometry.yaw_sigma=0.5"], calibration=robot)
    assert config.calibration.odometry.yaw_sigma == 0.5
    assert config.calibration.detection == load_config(calibration=robot).calibration.detection


def test_a_file_that_is_no_calibration_is_refused(dslam: Run, tmp_path: Path) -> None:
    path = tmp_path / "robot.toml"
    path.write_text("[odometry]\nyaw_sigm = 0.1\n", encoding="utf-8")
    command = ("replay", SAMPLE, "-o", tmp_path / "out.mcap", "--calibration", path)
    assert_refused(dslam(*command), str(path), "did you mean odometry.yaw_sigma?")
