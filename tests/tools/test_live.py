"""dslam live."""

import io
import sys
from pathlib import Path

import pytest

from slam.simulation.config import SimulationConfig
from tests.helpers.short_drives import drive, keep_until, stream_of, write_log
from tests.tools.runs import Run

pytest.importorskip("foxglove")


@pytest.mark.slow
@pytest.mark.parametrize("source", ["log", "-"])
def test_log_or_stream_is_mapped(dslam: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, source: str) -> None:
    entries = keep_until(drive(SimulationConfig()), 4.0)
    if source == "-":
        monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(stream_of(entries)))
    else:
        source = str(write_log(tmp_path / "drive.mcap", entries))
    found = dslam("live", source, "--speed", 0, "--port", 0, "-o", tmp_path / "out.mcap", "--json").json
    assert found["status"].startswith("optimised")
    assert set(found["latency_s"]) == {"p50", "p99", "max"}
    assert (tmp_path / "out.mcap").exists()
