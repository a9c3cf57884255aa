"""Drives of robots that are lost, replayed once for several files of tests."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pytest

from slam.common.config import Config
from slam.evaluation.inputs.records import EvaluationRecords, read_records
from slam.object_map.map_io import load_map
from slam.replay import replay
from slam.simulation.config import DriveConfig, KidnapConfig, SimulationConfig
from tests.helpers.loop_drives import ONE_BLOCK_ROUND_M, one_block
from tests.helpers.short_drives import drive, write_log


@dataclass(frozen=True, slots=True, eq=False)
class Relocalized:
    """``mapping``: the drive that made a map; ``found``: a second one in that map, which is left as it is."""

    mapping: EvaluationRecords
    found: EvaluationRecords


@pytest.fixture(scope="session")
def kidnapped(tmp_path_factory: pytest.TempPathFactory) -> EvaluationRecords:
    """A mapping drive in which the robot is taken from the last street to the first one, which it drives again."""
    return _kidnapped(tmp_path_factory.mktemp("kidnapped"), Config())


@pytest.fixture(scope="session")
def looked_up(tmp_path_factory: pytest.TempPathFactory) -> EvaluationRecords:
    """The same without propagation, so that each keyframe is looked up."""
    config = Config.model_validate({"loop_closure": {"propagation_distance_m": 0.0}})
    return _kidnapped(tmp_path_factory.mktemp("looked_up"), config)


def _kidnapped(folder: Path, config: Config) -> EvaluationRecords:
    kidnap = KidnapConfig(from_m=200.0, to_m=ONE_BLOCK_ROUND_M, gap_s=30.0)
    simulation = SimulationConfig(drive=DriveConfig(rate_hz=5.0), kidnap=kidnap)
    log = write_log(folder / "in.mcap", drive(simulation, world=one_block()))
    replay(log, folder / "out.mcap", config)
    return read_records(folder / "out.mcap")


@pytest.fixture(scope="session")
def relocalized(tmp_path_factory: pytest.TempPathFactory) -> Relocalized:
    """A drive around the block, and a second one in the map of the first."""
    folder = tmp_path_factory.mktemp("relocalized")
    simulation = SimulationConfig(drive=DriveConfig(rate_hz=5.0))
    first = write_log(folder / "first.mcap", drive(simulation, seed=1))
    second = write_log(folder / "second.mcap", drive(simulation, seed=2))
    replay(first, folder / "mapped.mcap", Config(), map_path=folder / "map.mcap")
    replay(second, folder / "found.mcap", Config(), prior_map=load_map(folder / "map.mcap"), extend=False)
    return Relocalized(read_records(folder / "mapped.mcap"), read_records(folder / "found.mcap"))
