"""dslam degrade, as it is typed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from logs.reader import LogReader
from tests.tools.runs import SAMPLE, Run, assert_refused, write_log

DETECTIONS = 3313
TREES = 1257


def metadata_of(path: Path) -> dict[str, dict[str, str]]:
    with LogReader(path) as reader:
        return reader.metadata()


def test_the_help_has_an_example(dslam: Run) -> None:
    result = dslam("degrade", "--help")
    assert result.code == 0
    assert "Example: dslam degrade" in " ".join(result.out.split())


def test_every_option_reaches_the_log(dslam: Run, tmp_path: Path) -> None:
    output = tmp_path / "out.mcap"
    options = {
        "field_of_view_deg": ("--field-of-view", 200.0),
        "max_range_m": ("--max-range", 25.0),
        "dropout": ("--dropout", 0.3),
        "label_confusion": ("--label-confusion", 0.1),
        "position_noise_m": ("--position-noise", 0.2),
        "false_positives": ("--false-positives", 1.5),
        "odometry_translation_noise": ("--odometry-translation-noise", 0.05),
        "odometry_yaw_noise": ("--odometry-yaw-noise", 0.001),
        "time_offset_s": ("--time-offset", -0.05),
    }
    typed = [part for flag in options.values() for part in flag]
    labels = ("--keep-label", "tree", "--keep-label", "bench", "--keep-label", "bollard", "--drop-label", "bench")
    result = dslam("degrade", SAMPLE, "-o", output, *typed, *labels, "--reversed", "--seed", 3, "--json")
    assert (result.code, result.err) == (0, "")
    told = json.loads(result.out)
    expected: dict[str, object] = {name: value for name, (_, value) in options.items()}
    expected |= {"keep_labels": ["tree", "bench", "bollard"], "drop_labels": ["bench"], "reversed": True}
    assert told["options"] == expected
    assert told["seed"] == 3
    assert told["detections"] == DETECTIONS
    lost = sum(told[name] for name in ("out_of_view", "unwanted_label", "dropped_out"))
    assert 0 < told["kept"] == DETECTIONS - lost
    assert told["false_positives"] > 0
    made = metadata_of(output)["degradation"]
    assert {name: json.loads(made[name]) for name in expected} == expected
    assert metadata_of(output)["simulation"] == metadata_of(SAMPLE)["simulation"]


def test_a_summary_for_people(dslam: Run, tmp_path: Path) -> None:
    result = dslam("degrade", SAMPLE, "-o", tmp_path / "out.mcap", "--drop-label", "tree")
    assert result.code == 0
    assert f"{DETECTIONS - TREES} of {DETECTIONS} detections" in result.out
    assert f"{TREES} of an unwanted class" in result.out
    assert [path.name for path in tmp_path.iterdir()] == ["out.mcap"]


@pytest.mark.slow
@pytest.mark.parametrize("option", [("--dropout", 0.3, "--position-noise", 0.1), ("--reversed",)])
def test_what_comes_out_can_be_mapped_and_evaluated(dslam: Run, tmp_path: Path, option: tuple[object, ...]) -> None:
    log, mapped = tmp_path / "log.mcap", tmp_path / "map.mcap"
    assert dslam("degrade", SAMPLE, "-o", log, *option).code == 0
    replayed = dslam("replay", log, "-o", mapped)
    assert replayed.code == 0
    assert "warnings      none" in replayed.out
    assert dslam("evaluate", mapped, "--require", "trajectory.ate_m<=1.0").code == 0


def test_refusals(dslam: Run, tmp_path: Path) -> None:
    output = tmp_path / "out.mcap"
    degrade = ("degrade", SAMPLE, "-o", output)
    assert_refused(dslam(*degrade), "nothing to do", "--dropout")
    assert_refused(dslam(*degrade, "--seed", 3), "nothing to do")
    assert_refused(dslam(*degrade, "--dropout", 1.5), "dropout=1.5", ">= 0 and <= 1")
    assert_refused(dslam(*degrade, "--max-range", "nan"), "max_range_m=nan", "> 0")
    assert_refused(dslam(*degrade, "--field-of-view", "wide"), "--field-of-view")
    assert_refused(dslam(*degrade, "--dropout", 0.1, "--seed", -1), "negative")
    assert_refused(dslam(*degrade, "--keep-label", "car"), "'car'", "tree", "utility_pole")
    assert_refused(dslam("degrade", tmp_path / "none.mcap", "-o", output, "--dropout", 0.1), "No such file")
    assert_refused(dslam("degrade", SAMPLE, "-o", tmp_path / "none" / "out.mcap", "--dropout", 0.1), "no folder")
    assert not list(tmp_path.iterdir())


def test_the_input_is_never_overwritten(dslam: Run, tmp_path: Path) -> None:
    log = write_log(tmp_path / "log.mcap")
    before = log.read_bytes()
    assert_refused(dslam("degrade", log, "-o", log, "--dropout", 0.1), "is the input")
    assert log.read_bytes() == before


def test_several_topics_that_fit(dslam: Run, tmp_path: Path) -> None:
    log, output = write_log(tmp_path / "log.mcap", detections=("/left", "/right")), tmp_path / "out.mcap"
    assert_refused(dslam("degrade", log, "-o", output, "--dropout", 1), "/left, /right", "--topic detections=/left")
    result = dslam("degrade", log, "-o", output, "--dropout", 1, "--topic", "detections=/left", "--json")
    assert json.loads(result.out)["dropped_out"] == 10


def test_a_log_without_detections(dslam: Run, tmp_path: Path) -> None:
    log = write_log(tmp_path / "log.mcap", detections=())
    assert_refused(dslam("degrade", log, "-o", tmp_path / "out.mcap", "--dropout", 1), "no topic gives detections")
