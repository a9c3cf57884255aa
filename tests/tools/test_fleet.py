"""dslam fleet: what it prints, and how it ends."""

import json
from pathlib import Path
from typing import Any

import pytest

from slam.fleet.fleet import Fleet
from slam.fleet.sessions import Session
from tests.tools.runs import Run, assert_refused


@pytest.mark.parametrize("reason", ["", "it holds no odometry"])
def test_fleet_exits_with_1_if_a_log_was_not_mapped(
    dslam: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, reason: str
) -> None:
    def map_nothing(logs: list[Any], *_: object, tell: Any, **__: object) -> Fleet:
        tell(f"1/1 {logs[0].name}: not mapped")
        sessions = {log.sha256: Session(log.sha256, reason) for log in logs}
        return Fleet(tuple(logs if reason else ()), sessions, (), {}, ())

    monkeypatch.setattr("slam.fleet.fleet.map_fleet", map_nothing)
    (tmp_path / "a.mcap").write_bytes(b"a")
    log, city = tmp_path / "a.mcap", tmp_path / "city"
    result = dslam("fleet", "add", city, log)
    assert result.code == (1 if reason else 0)
    assert reason in result.out
    assert "1/1" in result.err
    assert json.loads((city / "logs.json").read_text())[0]["name"] == str(log)
    unmet = dslam("fleet", "add", city, log, "--require", "figures.joined>=4")
    assert (unmet.code, "figures.joined is 0, where >= 4 was required" in unmet.err) == (1, True)


def test_fleet_add_refuses_a_log_in_place_of_the_folder(dslam: Run, tmp_path: Path) -> None:
    assert_refused(dslam("fleet", "add", tmp_path / "a.mcap"), "name the folder of the city before the logs")
    assert not (tmp_path / "a.mcap").exists()
