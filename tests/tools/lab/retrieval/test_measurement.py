"""Descriptors asked at the revisits of a drive: only what they propose counts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from slam.common.config import Config
from slam.common.errors import EvaluationError
from slam.common.geometry import transform_from_xyz_yaw
from slam.simulation.config import DriveConfig, SimulationConfig
from slam.simulation.world import World
from tests.helpers.short_drives import drive, write_log
from tools.lab.retrieval.measurement import is_right, measure_retrieval
from tools.lab.retrieval.recorded_places import RecordedPlaces, record_places

BLOCK_M = 60.0


def town(laps: int) -> World:
    rng = np.random.default_rng(11)
    corners = np.array([[0.0, 0.0], [BLOCK_M, 0.0], [BLOCK_M, BLOCK_M], [0.0, BLOCK_M]])
    positions = np.column_stack([rng.uniform(-10.0, BLOCK_M + 10.0, (110, 2)), np.ones(110)])
    labels = tuple(rng.choice(["bench", "bin", "hydrant", "lamp", "sign", "tree"], 110).tolist())
    return World("town", tuple(f"o{i}" for i in range(110)), positions, labels, np.vstack([corners] * laps))


def log(folder: Path, laps: int) -> Path:
    simulation = SimulationConfig(drive=DriveConfig(rate_hz=5.0))
    return write_log(folder / "town.mcap", drive(simulation, seed=4, world=town(laps)))


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> RecordedPlaces:
    return record_places(log(tmp_path_factory.mktemp("log"), 3), Config(), spacing_m=10.0)


@pytest.mark.slow
def test_a_good_descriptor_finds_what_random_vectors_do_not(recorded: RecordedPlaces) -> None:
    good, random = measure_retrieval(recorded, ["ring_likelihood", "random"])
    assert (good["queries"], good["entries"]) == (random["queries"], random["entries"])
    assert good["queries"] >= 3
    assert good["places_at_1"] == 1.0
    assert good["objects_at_1"] > 0.6 > random["objects_at_1"]
    for figures in (good, random):
        for kind in ("places", "objects"):
            assert figures[f"{kind}_at_1"] <= figures[f"{kind}_at_5"] <= figures[f"{kind}_at_25"]


@pytest.mark.slow
def test_a_query_never_finds_its_own_landmarks(recorded: RecordedPlaces) -> None:
    for place in recorded.asked:
        assert (
            len(place.allowed)
            == len(place.entry_positions)
            == sum(len(part.centres) for part in recorded.parts[: place.parts])
        )
        assert place.allowed.any()


@pytest.mark.slow
def test_a_drive_that_never_comes_back_asks_nothing(tmp_path: Path) -> None:
    with pytest.raises(EvaluationError, match="never comes back"):
        record_places(log(tmp_path, 1), Config(), spacing_m=10.0)


def test_a_pose_is_right_within_4_m_and_10_deg_of_any_true_one() -> None:
    truth = np.stack(
        [
            transform_from_xyz_yaw(np.array([0.0, 0.0, 0.0]), 0.0),
            transform_from_xyz_yaw(np.array([50.0, 0.0, 0.0]), 3.0),
        ]
    )
    poses = np.stack(
        [
            transform_from_xyz_yaw(np.array([3.9, 0.0, 0.0]), 0.1),
            transform_from_xyz_yaw(np.array([4.1, 0.0, 0.0]), 0.0),
            transform_from_xyz_yaw(np.array([0.0, 0.0, 0.0]), 0.2),
            transform_from_xyz_yaw(np.array([50.0, 2.0, 0.0]), 3.1),
        ]
    )
    assert is_right(poses, truth).tolist() == [True, False, False, True]
    assert is_right(np.zeros((0, 4, 4)), truth).tolist() == []
