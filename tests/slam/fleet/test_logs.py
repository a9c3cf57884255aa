from __future__ import annotations

from pathlib import Path

import pytest

from slam.common.errors import FleetError
from slam.fleet.logs import MEMBERS_NAME, FleetLog, add_logs, find_logs


def test_a_manifest_is_relative_to_itself_and_names_each_log_once(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(b"a")
    (tmp_path / "list.txt").write_text("# of Monday\na.mcap\n\na.mcap\n")
    (log,) = find_logs([], tmp_path / "list.txt", tmp_path / "cache")
    assert log.path == tmp_path / "a.mcap"


def test_a_url_is_fetched_once(tmp_path: Path) -> None:
    source = tmp_path / "drive.mcap"
    source.write_bytes(b"content")
    url = f"file://{source}"
    (log,) = find_logs([url], None, tmp_path / "cache")
    assert (log.name, log.path.read_bytes()) == (url, b"content")
    source.unlink()
    assert find_logs([url], None, tmp_path / "cache") == [log]


@pytest.mark.parametrize("source", ["missing.mcap", "file:///nowhere/drive.mcap", "odd://drive.mcap"])
def test_what_is_not_there_is_told_in_one_line(source: str, tmp_path: Path) -> None:
    with pytest.raises(FleetError, match=source.rpartition("/")[2]):
        find_logs([source], None, tmp_path / "cache")


def test_a_manifest_that_is_no_text_is_told(tmp_path: Path) -> None:
    (tmp_path / "list.txt").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(FleetError, match="manifest"):
        find_logs([], tmp_path / "list.txt", tmp_path / "cache")


def make_logs(folder: Path, **contents: str) -> list[FleetLog]:
    for name, content in contents.items():
        (folder / name).write_text(content)
    return [FleetLog(name, folder / name) for name in contents]


def test_no_log_at_all_is_refused(tmp_path: Path) -> None:
    (tmp_path / "list.txt").write_text("# none\n")
    with pytest.raises(FleetError, match="no log was given"):
        add_logs(tmp_path, find_logs([], tmp_path / "list.txt", tmp_path / "cache"))


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
    assert [log.name for log in members] == ["tonight", f"tonight@{members[1].sha256[:8]}"]


def test_a_damaged_list_of_logs_is_refused_with_the_remedy(tmp_path: Path) -> None:
    (tmp_path / MEMBERS_NAME).write_text("[{]")
    with pytest.raises(FleetError, match="remove it and name all logs"):
        add_logs(tmp_path, make_logs(tmp_path, monday="a"))
