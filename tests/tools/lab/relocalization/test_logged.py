"""Kidnappings on a log: the first round makes the map, the second is found in it, and a new street is not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from logs.messages import GroundTruthPose, Record
from slam.common.config import Config
from slam.common.errors import EvaluationError
from slam.common.geometry import transform_from_xyz_yaw
from slam.simulation.config import DriveConfig, SimulationConfig
from slam.simulation.world import World
from tests.helpers.short_drives import Entry, change, drive, write_log
from tools.lab.relocalization.logged import ELSEWHERE_M, benchmark_log
from tools.lab.relocalization.trial import Tolerance, Verdict

pytestmark = pytest.mark.slow

SLOW = SimulationConfig(drive=DriveConfig(rate_hz=5.0))
TOLERANCE = Tolerance(1.0, 3.0)
BLOCK_M = 60.0


def town() -> World:
    """Twice round a block, and then away from it along a street that was never driven before."""
    rng = np.random.default_rng(11)
    corners = np.array([[0.0, 0.0], [BLOCK_M, 0.0], [BLOCK_M, BLOCK_M], [0.0, BLOCK_M]])
    tour = np.vstack([corners, corners, [[0.0, 0.0], [-250.0, 0.0]]])
    x = np.concatenate([rng.uniform(-10.0, BLOCK_M + 10.0, 110), rng.uniform(-250.0, -10.0, 80)])
    y = np.concatenate([rng.uniform(-10.0, BLOCK_M + 10.0, 110), rng.uniform(3.0, 10.0, 80) * rng.choice([-1, 1], 80)])
    labels = tuple(rng.choice(["bench", "bin", "hydrant", "lamp", "sign", "tree"], len(x)).tolist())
    return World("town", tuple(f"o{i}" for i in range(len(x))), np.column_stack([x, y, np.ones(len(x))]), labels, tour)


@pytest.fixture(scope="module")
def entries() -> list[Entry]:
    return drive(SLOW, seed=4, world=town())


def first_round_s(entries: list[Entry]) -> float:
    """When the robot is back where it began, for the first time."""
    truth = [record for _, _, record in entries if isinstance(record, GroundTruthPose)]
    travelled_m = np.cumsum([0.0, *(np.linalg.norm(np.diff([p.T_world_body[:2, 3] for p in truth], axis=0), axis=1))])
    row = int(np.searchsorted(travelled_m, 4.0 * BLOCK_M))
    return (truth[row].stamp_ns - truth[0].stamp_ns) * 1e-9


def run(path: Path, entries: list[Entry], **more: object) -> dict[str, Any]:
    given = {"map_until_s": first_round_s(entries), "kidnaps": 4, "tolerance": TOLERANCE, **more}
    return benchmark_log(write_log(path / "town.mcap", entries), Config(), **given)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def measured(entries: list[Entry], tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    return run(tmp_path_factory.mktemp("log"), entries)


def test_on_the_second_round_it_is_found(measured: dict[str, Any]) -> None:
    assert [each["verdict"] for each in measured["outcomes"]] == [Verdict.RECOVERED] * 4
    assert measured["success_rate"] == 1.0
    assert all(4.0 * BLOCK_M <= each["start_m"] <= 8.0 * BLOCK_M for each in measured["outcomes"])
    assert all(each["is_along"] for each in measured["outcomes"])
    assert measured["tour_m"] == pytest.approx(4.0 * BLOCK_M, abs=5.0)


def test_on_a_new_street_it_is_not_found(measured: dict[str, Any]) -> None:
    assert measured["elsewhere_kidnaps"] == len(measured["elsewhere_outcomes"]) > 0
    assert measured["elsewhere_fixes"] == 0
    assert {each["verdict"] for each in measured["elsewhere_outcomes"]} == {Verdict.NOT_FOUND}
    assert all(each["start_m"] >= 8.0 * BLOCK_M + ELSEWHERE_M - 15.0 for each in measured["elsewhere_outcomes"])


def test_the_truth_only_judges(entries: list[Entry], tmp_path: Path, measured: dict[str, Any]) -> None:
    """With another world frame the same drives have the same verdicts and errors; with a false truth, others."""

    def moved(_: int, record: Record) -> Record:
        assert isinstance(record, GroundTruthPose)
        T = transform_from_xyz_yaw(np.array([100.0, 50.0, 0.0]), 1.0)
        return replace(record, T_world_body=T @ record.T_world_body)

    again = run(tmp_path, change(entries, GroundTruthPose, moved), kidnaps=2)
    by_number = {each["number"]: each for each in measured["outcomes"]}
    for each in again["outcomes"]:
        if each["number"] in by_number:
            assert each["error_m"] == pytest.approx(by_number[each["number"]]["error_m"], abs=1e-6)
    assert again["success_rate"] == 1.0
    strict = run(tmp_path, entries, kidnaps=1, tolerance=Tolerance(1e-6, 1e-6))
    assert strict["false_relocalization_rate"] == 1.0


def test_what_cannot_be_measured_is_said(entries: list[Entry], tmp_path: Path) -> None:
    with pytest.raises(EvaluationError, match="never comes within 5 m"):
        run(tmp_path, entries, map_until_s=2.0 * first_round_s(entries) + 5.0)
