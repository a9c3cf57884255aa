"""Simulated robots that are lost, and found again in a map of their own or of another drive."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from slam.common.config import Config
from slam.common.errors import EvaluationError
from slam.common.geometry import transform_from_xyz_yaw
from slam.evaluation.evaluate import evaluate
from slam.evaluation.inputs.records import EvaluationRecords, read_records
from slam.evaluation.metrics.relocalization import locate_map
from slam.object_map.map_io import load_map
from slam.replay import replay
from slam.simulation.config import DriveConfig, KidnapConfig, SimulationConfig
from tests.helpers.loop_drives import ONE_BLOCK_ROUND_M, one_block
from tests.helpers.short_drives import drive, write_log

pytestmark = pytest.mark.slow


def figures(records: EvaluationRecords, **options: np.ndarray) -> dict[str, float]:
    found: dict[str, float] = evaluate(records, **options).results["relocalization"]
    return found


def test_a_robot_that_is_kidnapped_while_it_maps(tmp_path: Path) -> None:
    """It is taken from the last street to the first one, which it drives again."""
    kidnap = KidnapConfig(from_m=200.0, to_m=ONE_BLOCK_ROUND_M, gap_s=30.0)
    simulation = SimulationConfig(drive=DriveConfig(rate_hz=5.0), kidnap=kidnap)
    log = write_log(tmp_path / "in.mcap", drive(simulation, world=one_block()))
    replay(log, tmp_path / "out.mcap", Config())
    kidnapped = read_records(tmp_path / "out.mcap")
    found = figures(kidnapped)
    assert [found[key] for key in ("method", "loss_count", "success_rate", "false_relocalization_rate")] == [
        "closure",
        1,
        1.0,
        0.0,
    ]
    assert 0.0 <= found["median_distance_m"] < 60.0
    assert 0.0 <= found["median_seconds"] < 30.0
    assert 0.0 <= max(loss["error_m"] for loss in found["losses"]) < 1.0
    assert "given none" in evaluate(kidnapped, map_alignment=np.eye(4)).unavailable["map_alignment"]


@pytest.fixture(scope="module")
def drives(tmp_path_factory: pytest.TempPathFactory) -> tuple[EvaluationRecords, EvaluationRecords]:
    """A drive around the block, and a second one in the map of the first, which is left as it is."""
    folder = tmp_path_factory.mktemp("relocalized")
    simulation = SimulationConfig(drive=DriveConfig(rate_hz=5.0))
    first = write_log(folder / "first.mcap", drive(simulation, seed=1))
    second = write_log(folder / "second.mcap", drive(simulation, seed=2))
    replay(first, folder / "mapped.mcap", Config(), map_path=folder / "map.mcap")
    replay(second, folder / "found.mcap", Config(), prior_map=load_map(folder / "map.mcap"), extend=False)
    return read_records(folder / "mapped.mcap"), read_records(folder / "found.mcap")


def test_common_offset_is_measured_only_in_located_map(drives: tuple[EvaluationRecords, EvaluationRecords]) -> None:
    mapping, found = drives
    T_world_map = locate_map(mapping)
    right = figures(found, map_alignment=T_world_map)
    assert (right["method"], right["loss_count"], right["success_rate"]) == ("map", 1, 1.0)
    assert right["median_error_m"] < 0.5
    assert len(found.relocalizations) > 10
    off = transform_from_xyz_yaw(np.array([6.0, 0.0, 0.0]), 0.0)
    assert found.trajectory is not None
    shifted = replace(
        found,
        online_poses=tuple(replace(p, T_map_body=off @ p.T_map_body) for p in found.online_poses),
        trajectory=replace(found.trajectory, T_map_body=off @ found.trajectory.T_map_body),
    )
    hidden, located = figures(shifted), figures(shifted, map_alignment=T_world_map)
    assert (hidden["method"], hidden["success_rate"]) == ("trajectory", 1.0)
    assert (located["success_rate"], located["false_relocalization_rate"]) == (0.0, 1.0)


def test_where_a_map_lies_must_be_known(drives: tuple[EvaluationRecords, EvaluationRecords]) -> None:
    mapping, found = drives
    with pytest.raises(EvaluationError, match="no ground truth"):
        locate_map(replace(mapping, true_poses=()))
    with pytest.raises(EvaluationError, match="no final trajectory"):
        locate_map(replace(mapping, trajectory=None))
    without = evaluate(replace(found, true_poses=()))
    assert "1 of 1 fixes: no ground truth" in without.unavailable["relocalization"]
    assert without.results["relocalization"]["success_rate"] is None
