"""dslam calibrate, and what uses its file."""

import json
from pathlib import Path

import pytest

import dslam as library
from slam.common.config import Config, load_config
from tests.helpers.short_drives import metadata_of
from tests.tools.runs import SAMPLE, Run, assert_refused, run_well


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("calibrate") / "robot.toml"
    run_well("calibrate", SAMPLE, "-o", path)
    return path


def test_file_holds_the_calibration_of_the_library(robot: Path) -> None:
    calibration = load_config(calibration=robot).calibration
    assert calibration.is_complete
    assert calibration == library.calibrate(SAMPLE)


def test_several_logs_are_pooled(dslam: Run, robot: Path) -> None:
    pooled = dslam("calibrate", SAMPLE, SAMPLE, "--json").json["calibration"]
    assert pooled["evidence"]["scans"] == 2 * load_config(calibration=robot).calibration.evidence["scans"]


@pytest.mark.parametrize("is_given", [True, False])
def test_replay_uses_the_file_or_estimates_the_same(
    dslam: Run, robot: Path, mapped: Path, tmp_path: Path, is_given: bool
) -> None:
    output, again = (tmp_path / "out.mcap") if is_given else mapped, tmp_path / "same.toml"
    if is_given:
        assert dslam("replay", SAMPLE, "-o", output, "--calibration", robot).code == 0
    about = metadata_of(output)["dslam"]
    assert (json.loads(about["estimated"]) == {}) == is_given
    again.write_text(dslam("config", "--from", output).out)
    used, known = load_config(calibration=robot), load_config(again)
    if is_given:
        assert Config.model_validate_json(about["configuration"]) == known == used
    for part in ("odometry", "detection", "objects", "sigmas", "evidence"):
        assert getattr(known.calibration, part) == getattr(used.calibration, part)


def test_a_file_that_is_no_calibration_is_refused(dslam: Run, tmp_path: Path) -> None:
    path = tmp_path / "robot.toml"
    path.write_text("[odometry]\nyaw_sigm = 0.1\n", encoding="utf-8")
    command = ("replay", SAMPLE, "-o", tmp_path / "out.mcap", "--calibration", path)
    assert_refused(dslam(*command), str(path), "did you mean odometry.yaw_sigma?")
