"""One log, and sweeps."""

from pathlib import Path

import numpy as np
import pytest

from slam.common.geometry import make_transform
from slam.evaluation.evaluate import evaluate
from slam.evaluation.inputs.records import read_records
from tests.tools.runs import SAMPLE, Run, assert_refused, assert_well

pytestmark = pytest.mark.slow


def test_requirements_decide_the_exit_code(dslam: Run, mapped: Path) -> None:
    bars = ("--require", "trajectory.ate_m<=1.0", "--require", "landmarks.precision>=0.5")
    result = dslam("evaluate", mapped, *bars)
    assert result.code == 0
    met = [line for line in result.out.splitlines() if line.startswith("met: ")]
    assert [line.split()[1] for line in met] == ["trajectory.ate_m", "landmarks.precision"]
    unmet = dslam("evaluate", mapped, "--require", "trajectory.ate_m<=0.000001")
    assert unmet.code == 1
    assert "ATE" in unmet.out
    assert unmet.err.count("\n") == 1
    assert "trajectory.ate_m is" in unmet.err
    assert_refused(dslam("evaluate", mapped, "--require", "trajectory.ate_m=4"), "expected for example")


def test_a_fix_is_measured_in_the_map_that_was_given(dslam: Run, short_log: Path, tmp_path: Path) -> None:
    saved, later = tmp_path / "saved.mcap", tmp_path / "later.mcap"
    assert dslam("replay", short_log, "-o", tmp_path / "first.mcap", "--save-map", saved).code == 0
    assert dslam("replay", short_log, "-o", later, "--map", saved).code == 0
    told = [
        dslam("evaluate", later, *option, "--json").json["relocalization"]
        for option in ((), ("--map-run", tmp_path / "first.mcap"))
    ]
    assert [each["method"] for each in told] == ["trajectory", "map"]
    T_world_map = make_transform(np.eye(3), np.array([100.0, 0.0, 0.0]))
    moved = evaluate(read_records(later), map_alignment=T_world_map).to_json_dict()["relocalization"]
    assert moved["median_error_m"] == pytest.approx(100.0, abs=5.0)
    assert_refused(dslam("evaluate", later, "--map-run", SAMPLE), f"--map-run {SAMPLE}", "no estimated pose")


def test_sweep_prints_a_table_and_reuses_results(dslam: Run, short_log: Path, tmp_path: Path) -> None:
    command = ("sweep", short_log, "-o", tmp_path / "sweep", "--degrade", "dropout=0.5", "--seeds", 1, "--jobs", 1)
    variant = ("--variant", "keyframe.distance_m=3;calibrate=false")
    result = assert_well(dslam(*command, *variant))
    assert "2 drives mapped, 0 mapped before" in result.out
    assert all(part in result.out for part in ("faults=dropout=0.5", "(1 runs)", "least to greatest"))
    again = dslam(*command, *variant, "--json", "--require", "trajectory.ate_m<=0")
    assert again.code == 1
    assert "dropout=0.5, seed 0: trajectory.ate_m is" in again.err
    assert again.json["computed"] == 0
    assert list(again.json["groups"]) == ["faults=none", "faults=dropout=0.5"]


def test_sweep_names_a_drive_that_fails_and_ends_with_1(dslam: Run, short_log: Path, tmp_path: Path) -> None:
    sweep = ("-o", tmp_path / "sweep", "--jobs", 1, "--degrade", "keep_label=unicorn", "--markdown")
    result = dslam("sweep", short_log, *sweep)
    assert result.code == 1
    assert result.err.startswith("dslam: failed: keep_label=unicorn, seed 0: ")
    assert result.err.count("\n") == 1
    assert "| faults=keep_label=unicorn (1 runs) | – |" in result.out


def test_sweep_refuses(dslam: Run, mapped: Path, tmp_path: Path) -> None:
    output = ("-o", tmp_path / "sweep")
    assert_refused(dslam("sweep", mapped, *output), "give the drive")
    assert_refused(dslam("sweep", SAMPLE, *output, "--degrade", "drop=1"), "did you mean")
    assert_refused(dslam("sweep", SAMPLE, "-o", SAMPLE), str(SAMPLE))
    assert not (tmp_path / "sweep").exists()
