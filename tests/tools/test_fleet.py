"""dslam fleet: what it prints, and how it ends."""

from __future__ import annotations

import json
import re
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
        return Fleet(tuple(logs if reason else ()), sessions, (), (), (), ())

    monkeypatch.setattr("slam.fleet.fleet.map_fleet", map_nothing)
    (tmp_path / "a.mcap").write_bytes(b"a")
    log, city = tmp_path / "a.mcap", tmp_path / "city"
    result = dslam("fleet", "add", city, log)
    assert result.code == (1 if reason else 0)
    assert reason in result.out
    assert "1/1" in result.err
    assert json.loads((city / "logs.json").read_text())[0]["name"] == str(log)


def test_fleet_add_refuses_a_log_in_place_of_the_folder(dslam: Run, tmp_path: Path) -> None:
    assert_refused(dslam("fleet", "add", tmp_path / "a.mcap"), "name the folder of the city before the logs")
    assert not (tmp_path / "a.mcap").exists()


def test_fleet_status_lists_reported_and_waiting_logs(dslam: Run, tmp_path: Path) -> None:
    assert_refused(dslam("fleet", "status", tmp_path), "holds no fleet")
    members = [{"name": name, "path": f"/data/{name}", "sha256": name} for name in ("a.mcap", "b.mcap")]
    (tmp_path / "logs.json").write_text(json.dumps(members), encoding="utf-8")
    reported = {"log": "a.mcap", "status": "alone", "notes": ["its clock was set"]}
    (tmp_path / "report.json").write_text(json.dumps({"logs": [reported]}), encoding="utf-8")
    result = dslam("fleet", "status", tmp_path)
    assert result.code == 0
    assert "a.mcap: its clock was set" in result.out
    assert re.search(r"b\.mcap +waiting", result.out)
    figures = {"logs": [reported], "figures": {"joined": 3}}
    (tmp_path / "report.json").write_text(json.dumps(figures), encoding="utf-8")
    assert dslam("fleet", "status", tmp_path, "--require", "figures.joined>=3").code == 0
    unmet = dslam("fleet", "status", tmp_path, "--require", "figures.joined>=4")
    assert (unmet.code, "figures.joined is 3, where >= 4 was required" in unmet.err) == (1, True)
    (tmp_path / "report.json").write_text("[", encoding="utf-8")
    assert_refused(dslam("fleet", "status", tmp_path), "cannot be read", "run the fleet again")
