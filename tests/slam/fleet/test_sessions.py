from dataclasses import replace
from pathlib import Path

import pytest

from slam.common.config import Config
from slam.common.errors import FleetError, SavedMapError
from slam.fleet.sessions import MEMBERS_NAME, FleetLog, add_logs, find_logs, map_session, map_sessions, session_folder

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
    assert all("add it again" in session.reason for session in sessions.values())


def make_logs(folder: Path, **contents: str) -> list[FleetLog]:
    for name, content in contents.items():
        (folder / name).write_text(content)
    return [replace(log, name=log.path.name) for log in find_logs([str(folder / name) for name in contents])]


def test_a_missing_log_and_none_at_all_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FleetError, match=r"there is no log missing\.mcap"):
        find_logs(["missing.mcap"])
    with pytest.raises(FleetError, match="no log was given"):
        add_logs(tmp_path, [])


def test_logs_of_earlier_nights_stay(tmp_path: Path) -> None:
    add_logs(tmp_path, make_logs(tmp_path, monday="a", tuesday="b"))
    (tmp_path / "monday").unlink()
    members = add_logs(tmp_path, make_logs(tmp_path, tuesday="b", wednesday="c"))
    assert [log.name for log in members] == ["monday", "tuesday", "wednesday"]
    assert [log.name for log in add_logs(tmp_path, [])] == ["monday", "tuesday", "wednesday"]
    assert [log.name for log in add_logs(tmp_path, [members[1]], only=True)] == ["tuesday"]


def test_another_content_by_the_same_name_is_another_log(tmp_path: Path) -> None:
    add_logs(tmp_path, make_logs(tmp_path, tonight="a"))
    members = add_logs(tmp_path, make_logs(tmp_path, tonight="b"))
    assert [log.name for log in members] == ["tonight", "tonight"]


def test_a_damaged_list_of_logs_is_refused_with_the_remedy(tmp_path: Path) -> None:
    (tmp_path / MEMBERS_NAME).write_text("[{]")
    with pytest.raises(FleetError, match="remove it and name all logs"):
        add_logs(tmp_path, make_logs(tmp_path, monday="a"))
