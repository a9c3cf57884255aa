"""Drives that several files of tests share; each is simulated and replayed once."""

from __future__ import annotations

from pathlib import Path

import pytest

from slam.common.config import Config
from slam.replay import replay
from slam.simulation.config import SimulationConfig
from tests.helpers.short_drives import Entry, drive, write_log


@pytest.fixture(scope="session")
def exact_drive() -> list[Entry]:
    """Once around the block, without any error."""
    return drive()


@pytest.fixture(scope="session")
def noisy_drive() -> list[Entry]:
    """Once around the block, with the simulator's default noise."""
    return drive(SimulationConfig())


@pytest.fixture(scope="session")
def noisy_log(noisy_drive: list[Entry], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_log(tmp_path_factory.mktemp("noisy") / "in.mcap", noisy_drive)


@pytest.fixture(scope="session")
def noisy_output(noisy_log: Path) -> Path:
    output = noisy_log.with_name("out.mcap")
    replay(noisy_log, output, Config())
    return output
