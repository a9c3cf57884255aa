from dataclasses import replace
from pathlib import Path

import pytest

from slam.common.errors import FleetError
from slam.fleet.logs import MEMBERS_NAME, FleetLog, add_logs, find_logs


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
