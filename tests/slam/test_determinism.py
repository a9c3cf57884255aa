"""The same log and configuration give the same bytes: in other processes, from other folders, with other hash seeds."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from slam.common.config import Config
from slam.replay import replay
from tests.helpers.short_drives import drive, keep_until, write_log
from tests.tools.runs import ROOT

pytestmark = pytest.mark.slow

REPLAY = """
import sys
from pathlib import Path
from slam.common.config import Config
from slam.replay import replay
replay(Path(sys.argv[1]), Path(sys.argv[2]), Config())
"""


def replay_elsewhere(source: Path, folder: Path, hash_seed: str) -> bytes:
    """The output of a process of its own, which runs in ``folder`` and is given relative paths."""
    folder.mkdir()
    environment = {**os.environ, "PYTHONHASHSEED": hash_seed, "PYTHONPATH": str(ROOT)}
    arguments = [sys.executable, "-c", REPLAY, os.path.relpath(source, folder), "out.mcap"]
    subprocess.run(arguments, cwd=folder, env=environment, check=True)
    return (folder / "out.mcap").read_bytes()


def test_two_processes_write_the_same_bytes(tmp_path):
    source = write_log(tmp_path / "in.mcap", keep_until(drive(), 15.0))
    first = replay_elsewhere(source, tmp_path / "a", "1")
    assert len(first) > 10_000
    assert replay_elsewhere(source, tmp_path / "b", "2") == first
    replay(source, tmp_path / "here.mcap", Config())
    assert (tmp_path / "here.mcap").read_bytes() == first
