"""Descriptors asked at the revisits of a drive: only what they propose counts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from slam.common.config import Config
from slam.common.geometry import transform_from_xyz_yaw
from slam.simulation.config import DriveConfig, SimulationConfig
from slam.simulation.world import World
from tests.helpers.short_drives import drive, write_log
from tools.lab.retrieval.labelled_map import is_right
from tools.lab.retrieval.revisits import measure_revisits

BLOCK_M = 60.0


def town(laps: int) -> World:
    rng = np.random.default_rng(11)
    corners = np.array([[0.0, 0.0], [BLOCK_M, 0.0], [BLOCK_M, BLOCK_M], [0.0, BLOCK_M]])
    positions = np.column_stack([rng.uniform(-10.0, BLOCK_M + 10.0, (110, 2)), np.ones(110)])
    labels = ("tree",) * 110  # with classes random vectors find places in so small a map, too
    return World("town", tuple(f"o{i}" for i in range(110)), positions, labels, np.vstack([corners] * laps))


def log(folder: Path, laps: int) -> Path:
    simulation = SimulationConfig(drive=DriveConfig(rate_hz=5.0))
    return write_log(folder / "town.mcap", drive(simulation, seed=4, world=town(laps)))


@pytest.mark.slow
def test_descriptor_finds_places_that_random_vectors_do_not(tmp_path: Path) -> None:
    done: list[float] = []
    good, random = measure_revisits(
        log(tmp_path, 3), ["descriptellation_lr", "random"], Config(), on_progress=done.append
    )
    assert (good["drive"], good["descriptor"], random["descriptor"]) == ("town", "descriptellation_lr", "random")
    assert good["queries"] == random["queries"] >= 3
    assert good["places_at_1"] > random["places_at_1"] + 0.2
    for figures in (good, random):
        assert figures["places_at_1"] <= figures["places_at_5"] <= figures["places_at_25"]
    assert done == sorted(done)
    assert done[-1] == 1.0


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
