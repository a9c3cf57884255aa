from pathlib import Path

import pytest

from slam.common.errors import InputDataError
from tools.lab.drives.robot_drives import find_drives


@pytest.fixture
def data(tmp_path: Path) -> Path:
    for name in ("b/odometry.tum", "b/detections.csv", "a/two/odometry.txt.gz", "a/two/groundtruth.tum.gz", "a/README"):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    (tmp_path / "b" / "odometry.old").mkdir()
    return tmp_path


def test_every_folder_with_odometry_is_a_drive(data: Path) -> None:
    assert list(find_drives(data).items()) == [("a/two", data / "a" / "two"), ("b", data / "b")]


def test_a_folder_may_itself_be_a_drive(data: Path) -> None:
    assert list(find_drives(data / "b")) == ["b"]


def test_names_choose_drives_and_folders_of_drives(data: Path) -> None:
    assert list(find_drives(data, ["a"])) == ["a/two"]
    assert list(find_drives(data, ["b", "a/two"])) == ["a/two", "b"]
    with pytest.raises(InputDataError, match="holds no drive 'a/t'; it holds a/two, b"):
        find_drives(data, ["a/t"])


def test_a_folder_without_drives_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputDataError, match=r"holds no drives; expected folders with odometry\.tum"):
        find_drives(tmp_path)
