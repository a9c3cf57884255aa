"""Odometry that jumps, freezes or pauses: the landmarks around correct it."""

from pathlib import Path

import pytest

from slam.common.config import Config
from slam.evaluation.evaluate import evaluate
from slam.evaluation.inputs.records import read_records
from slam.replay import replay
from slam.simulation.faults.faulty_log import write_faulty
from slam.simulation.faults.registry import parse_faults


def mapped(log: Path, folder: Path, *faults: str) -> tuple[float, dict[str, int]]:
    """ATE [m] and counters of a replay with faults."""
    write_faulty(log, folder / "faulty.mcap", parse_faults(faults), seed=0)
    counters = replay(folder / "faulty.mcap", folder / "mapped.mcap", Config()).counters
    estimate = evaluate(read_records(folder / "mapped.mcap")).estimate
    return estimate.ate_m, counters


@pytest.fixture
def clean_ate_m(noisy_replay) -> float:
    assert not {"odometry_corrected", "odometry_wild"} & set(noisy_replay.summary.counters)
    return evaluate(read_records(noisy_replay.output)).estimate.ate_m


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "counter"),
    [
        ("heading_jump=-120", "odometry_corrected"),
        ("pitch_jump=25", "odometry_corrected"),
        ("odometry_jumps=1:60", "odometry_corrected"),
        ("odometry_wild=500", "odometry_wild"),
    ],
)
def test_jump_is_corrected_and_counted(noisy_log, clean_ate_m, tmp_path, fault, counter):
    ate_m, counters = mapped(noisy_log, tmp_path, fault)
    assert ate_m < 1.5 * clean_ate_m + 0.01
    assert counters[counter] == 1
    assert counters.get("odometry_breaks", 0) == 0


@pytest.mark.slow
@pytest.mark.xfail(strict=True, reason="few objects in view: ATE 0.31 and 0.36 m, 0.102 wanted")
def test_landmarks_give_the_motion_where_the_odometry_freezes(noisy_log, clean_ate_m, tmp_path):
    ate_m, counters = mapped(noisy_log, tmp_path, "odometry_freezes=5")
    assert ate_m < 1.5 * clean_ate_m + 0.05
    assert counters["odometry_corrected"] > 10
    assert counters.get("odometry_breaks", 0) == 0


@pytest.mark.slow
def test_pause_of_nine_seconds_is_no_break(noisy_log, clean_ate_m, tmp_path):
    ate_m, counters = mapped(noisy_log, tmp_path, "odometry_pause=9")
    assert ate_m < 2.0 * clean_ate_m + 0.1
    assert counters.get("kidnappings_detected", 0) == 0
