"""Kidnapped robots on a drive: the first round is mapped, the second is found in it, and a new street is not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from logs.messages import GroundTruthPose, Record, SlamPose
from slam.common.config import Config
from slam.common.errors import EvaluationError
from slam.common.geometry import transform_from_xyz_yaw
from slam.evaluation.inputs.protocol import Protocol
from slam.localization.state import State
from slam.simulation.config import DriveConfig, SimulationConfig
from slam.simulation.world import World
from slam.system import Slam
from tests.helpers.short_drives import Entry, change, drive, write_log
from tools.lab.relocalization.kidnappings import benchmark_relocalization
from tools.lab.relocalization.trial import RECOVERED_WITHIN_M, Verdict

pytestmark = pytest.mark.slow

SLOW = SimulationConfig(drive=DriveConfig(rate_hz=5.0))
GIVEN = Config.model_validate({"calibrate": False})
PROTOCOL = Protocol(closure_translation_m=1.0, closure_rotation_deg=3.0)
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


def run(path: Path, entries: list[Entry], **more: Any) -> dict[str, Any]:
    options = {"given": first_round_s(entries), "kidnaps": 4, "protocol": PROTOCOL, **more}
    return benchmark_relocalization(write_log(path / "town.mcap", entries), GIVEN, **options)


@pytest.fixture(scope="module")
def measured(entries: list[Entry], tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    return run(tmp_path_factory.mktemp("log"), entries)


def test_robot_is_found_on_the_second_round(measured: dict[str, Any]) -> None:
    assert measured["success_rate"] == 1.0
    for outcome in measured["outcomes"]:
        assert outcome["verdict"] == Verdict.RECOVERED
        assert 4.0 * BLOCK_M <= outcome["start_m"] <= 8.0 * BLOCK_M
        assert outcome["is_along"]
        assert outcome["later_right"]
        assert 0.0 < outcome["distance_m"] <= RECOVERED_WITHIN_M
        assert outcome["seconds"] >= outcome["distance_m"] / 8.0 - 0.2  # no drive is faster than 8 m/s


def test_robot_is_not_found_on_a_new_street(measured: dict[str, Any]) -> None:
    assert measured["elsewhere_kidnaps"] == len(measured["elsewhere_outcomes"]) > 0
    assert measured["elsewhere_fixes"] == 0
    for outcome in measured["elsewhere_outcomes"]:
        assert outcome["verdict"] == Verdict.NOT_FOUND
        assert {outcome[name] for name in ("distance_m", "seconds", "error_m", "error_deg", "later_right")} == {None}
        assert outcome["start_m"] >= 8.0 * BLOCK_M + 2.0 * GIVEN.sensor_range_m - 15.0


def test_truth_only_judges(entries: list[Entry], tmp_path: Path, measured: dict[str, Any]) -> None:
    """With another world frame the same drives have the same verdicts and errors; a strict tolerance has others."""

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
    strict = run(tmp_path, entries, kidnaps=1, protocol=replace(PROTOCOL, closure_translation_m=1e-6))
    assert strict["false_relocalization_rate"] == 1.0


class GivesUp(Slam):
    """Loses its place again after it has known it for a while."""

    known = 0

    @property
    def state(self) -> State:
        return State.LOST if self.known > 3 else super().state

    def process(self, record: Record) -> list[Record]:
        updates = super().process(record)
        self.known += any(isinstance(each, SlamPose) for each in updates)
        return [each for each in updates if self.known <= 3 or not isinstance(each, SlamPose)]


def test_revoked_fix_is_not_right_later(
    entries: list[Entry], tmp_path: Path, measured: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tools.lab.relocalization.trial.Slam", GivesUp)
    outcomes = {each["number"]: each for each in measured["outcomes"]}
    for outcome in run(tmp_path, entries)["outcomes"]:
        assert outcome["later_right"] is None
        assert outcome["error_m"] == outcomes[outcome["number"]]["error_m"]


def test_drive_that_never_returns_is_refused(entries: list[Entry], tmp_path: Path) -> None:
    with pytest.raises(EvaluationError, match="never stays within 5 m"):
        run(tmp_path, entries, given=2.0 * first_round_s(entries) + 5.0)
