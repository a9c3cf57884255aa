"""Drives that several files of tests share; each is simulated and replayed once."""

import re
from dataclasses import dataclass
from pathlib import Path

import pytest

from slam.common.config import Config
from slam.replay import ReplaySummary, replay
from slam.simulation.config import SimulationConfig
from tests.helpers.short_drives import Entry, drive, keep_until, write_log
from tests.tools.runs import Result, Run
from tools import cli

_ALL_SLOW = re.compile(r"^pytestmark = (\[\s*)?pytest\.mark\.slow\b", re.MULTILINE)


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Files with slow tests alone are not even imported where these are left out."""
    if config.getoption("markexpr") != "not slow" or not collection_path.match("test_*.py"):
        return None
    return True if _ALL_SLOW.search(collection_path.read_text(encoding="utf-8")) else None


@pytest.fixture
def dslam(capsys: pytest.CaptureFixture[str]) -> Run:
    """The command line, in this process."""

    def run(*arguments: object) -> Result:
        code = cli.run([str(argument) for argument in arguments])
        return Result(code, *capsys.readouterr())

    return run


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
def short_log(noisy_drive: list[Entry], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Its first five seconds."""
    return write_log(tmp_path_factory.mktemp("short") / "drive.mcap", keep_until(noisy_drive, 5.0))


@dataclass(frozen=True)
class Replayed:
    """The files of a replay and what it printed."""

    output: Path
    summary: ReplaySummary
    progress: list[float]


@pytest.fixture(scope="session")
def noisy_replay(noisy_log: Path) -> Replayed:
    output, progress = noisy_log.with_name("out.mcap"), list[float]()
    return Replayed(
        output, replay(noisy_log, output, Config(), copy=["/detections"], progress=progress.append), progress
    )


@pytest.fixture(scope="session")
def noisy_output(noisy_replay: Replayed) -> Path:
    return noisy_replay.output
