"""dslam fleet: what it prints, and how it ends."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from slam.fleet.fleet import Fleet
from slam.fleet.sessions import Session
from tests.tools.runs import Run


@pytest.mark.parametrize("reason", ["", "it holds no odometry"])
def test_a_log_that_was_not_mapped_makes_the_exit_code_1(
    dslam: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, reason: str
) -> None:
    def map_nothing(logs: list[Any], *_: object, progress: Any, **__: object) -> Fleet:
        progress(0.5, f"1/1 {logs[0].name}: not mapped")
        sessions = {log.sha256: Session(log.sha256, reason) for log in logs if reason}
        names = {log.name: log.sha256 for log in logs if reason}
        return Fleet(names, sessions, (), (), (), (), ())

    monkeypatch.setattr("slam.fleet.fleet.map_fleet", map_nothing)
    (tmp_path / "a.mcap").write_bytes(b"a")
    result = dslam("fleet", tmp_path / "a.mcap", "-o", tmp_path / "city")
    assert result.code == (1 if reason else 0)
    assert reason in result.out
    assert "1/1" in result.err
    assert json.loads((tmp_path / "city" / "logs.json").read_text())[0]["name"] == str(tmp_path / "a.mcap")
