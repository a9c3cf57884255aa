from pathlib import Path

import pytest

from slam.common.config import Config
from slam.common.errors import FleetError, SavedMapError
from slam.fleet.logs import FleetLog
from slam.fleet.sessions import map_session, map_sessions, session_folder

LOG = FleetLog("a", Path("a.mcap"), "0")


def test_why_a_log_has_no_map_is_told_by_the_same_bytes_each_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(log: Path, output: Path, config: Config, *, map_path: Path) -> None:
        raise SavedMapError(f"{map_path} was not written")

    monkeypatch.setattr("slam.fleet.sessions.replay", refuse)
    left_behind = session_folder(tmp_path / "a", LOG.sha256, Config()) / "mapping" / "map.mcap.part"
    left_behind.parent.mkdir(parents=True)
    left_behind.touch()
    sessions = [map_session(LOG, tmp_path / name, Config()) for name in ("a", "b")]
    assert sessions[0].reason == "map.mcap was not written"
    assert sessions[0] == sessions[1]
    assert not left_behind.exists()


def test_map_sessions_refuses_log_that_is_gone_before_it_was_mapped(tmp_path: Path) -> None:
    with pytest.raises(FleetError, match="remove it with --only"):
        map_sessions([LOG], tmp_path, Config(), workers=1, tell=print)


def test_log_whose_process_dies_is_not_mapped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("slam.fleet.sessions.compute_all", lambda _, logs, jobs: ((log, None) for log in logs))
    (tmp_path / "a.mcap").write_bytes(b"a")
    logs = [FleetLog(name, tmp_path / "a.mcap", name) for name in ("a", "b")]
    lines = []
    sessions = map_sessions(logs, tmp_path, Config(), workers=2, tell=lines.append)
    assert lines == ["1/2 a.mcap: not mapped", "2/2 a.mcap: not mapped"]
    assert all("add it again" in session.reason and not session.is_mapped for session in sessions.values())
