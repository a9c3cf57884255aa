"""Kidnapped robots on a drive: the first round is mapped, the second is found in it, and a new street is not."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from logs.messages import GroundTruthPose
from slam.common.config import Config
from slam.common.errors import EvaluationError
from slam.common.geometry import travelled_m
from tests.helpers.loop_drives import SLOW, furnished
from tests.helpers.poses import pose_at
from tests.helpers.short_drives import Entry, drive, write_log
from tools.lab.relocalization.kidnappings import RECOVERED_WITHIN_M, benchmark_relocalization, deviation, figures

GIVEN = Config.model_validate({"calibrate": False})
BLOCK_M = 60


@pytest.fixture(scope="module")
def entries() -> list[Entry]:
    """Twice round a block, and then away from it along a street that was never driven before."""
    corners = [(0, 0), (BLOCK_M, 0), (BLOCK_M, BLOCK_M), (0, BLOCK_M)]
    return drive(SLOW, seed=4, world=furnished([*corners, *corners, (0, 0), (-250, 0)], seed=11))


def first_round_s(entries: list[Entry]) -> float:
    """When the robot is back where it began, for the first time."""
    truth = [record for _, _, record in entries if isinstance(record, GroundTruthPose)]
    along_m = travelled_m(np.array([pose.T_world_body[:2, 3] for pose in truth]))
    row = int(np.searchsorted(along_m, 4 * BLOCK_M))
    return (truth[row].stamp_ns - truth[0].stamp_ns) * 1e-9


def run(path: Path, entries: list[Entry], **more: Any) -> dict[str, Any]:
    options = {"given": first_round_s(entries), "kidnaps": 4, **more}
    return benchmark_relocalization(write_log(path / "town.mcap", entries), GIVEN, **options)


@pytest.mark.slow
def test_robot_is_found_on_the_second_round_and_not_on_a_new_street(entries: list[Entry], tmp_path: Path) -> None:
    measured = run(tmp_path, entries)
    assert measured["everywhere"]["success_rate"] == 1.0
    for outcome in measured["outcomes"]:
        assert outcome["is_right"]
        assert 0.0 < outcome["distance_m"] <= RECOVERED_WITHIN_M
        assert outcome["seconds"] >= outcome["distance_m"] / 8.0 - 0.2  # no drive is faster than 8 m/s
    assert len(measured["elsewhere"]) > 0
    for outcome in measured["elsewhere"]:
        assert {outcome[name] for name in ("distance_m", "seconds", "error_m", "error_deg", "is_right")} == {None}


@pytest.mark.slow
def test_drive_that_never_returns_is_refused(entries: list[Entry], tmp_path: Path) -> None:
    with pytest.raises(EvaluationError, match="never stays within 5 m"):
        run(tmp_path, entries, given=2.0 * first_round_s(entries) + 5.0)


def outcome(is_right: bool | None, distance_m: float | None, query_ms: tuple[float, ...] = (2.0,)) -> dict[str, Any]:
    error_m = None if distance_m is None else 0.01 * distance_m if is_right else 7.0
    seconds = None if distance_m is None else distance_m / 8.0
    return {
        "is_right": is_right,
        "distance_m": distance_m,
        "seconds": seconds,
        "error_m": error_m,
        "error_deg": error_m,
        "query_ms": list(query_ms),
    }


def test_figures_of_outcomes_by_hand() -> None:
    right, late = [outcome(True, distance_m) for distance_m in (8.0, 10.0, 40.0)], outcome(True, 50.0)
    wrong = [outcome(False, distance_m, (8.0, 9.0)) for distance_m in (1.0, 2.0)]
    told = figures(pd.DataFrame([*right, late, *wrong, outcome(None, None), outcome(None, None, ())], dtype=object))
    expected = {
        "kidnaps": 8,
        "success_rate": 3 / 8,
        "late_rate": 1 / 8,
        "false_relocalization_rate": 2 / 8,
        "not_found_rate": 2 / 8,
        "median_distance_m": 25.0,
        "p95_distance_m": 48.5,
        "median_seconds": 25.0 / 8.0,
        "median_error_m": 0.45,
        "p95_error_m": 7.0,
        "median_error_deg": 0.45,
        "query_ms": 2.0,
    }
    assert told == pytest.approx(expected)
    lost = figures(pd.DataFrame([outcome(None, None, ())], dtype=object))
    assert (lost["not_found_rate"], lost["median_distance_m"], lost["query_ms"]) == (1.0, None, None)


def test_deviation_is_in_the_plane_and_the_shorter_way_round() -> None:
    a = pose_at(1.0, 2.0, z=9.0, yaw=np.deg2rad(179.0))
    b = pose_at(4.0, -2.0, yaw=np.deg2rad(-178.0))
    assert deviation(a, b) == deviation(b, a) == pytest.approx((5.0, 3.0))
