"""dslam benchmark ablation."""

from __future__ import annotations

import json
import pkgutil
from pathlib import Path

import pytest

from slam.common.config import Config, load_config
from tests.logs.importers.text_drives import TextDrive
from tests.tools.runs import Run, assert_refused
from tools.lab.drives import ablation_drives
from tools.lab.drives.ablation_parts import DEFAULT, PARTS, switched_off


@pytest.mark.parametrize("part", [part for part in PARTS if part != DEFAULT])
def test_settings_and_functions_of_each_part_exist(part: str) -> None:
    off = PARTS[part]
    assert (load_config(None, off.settings) != Config()) == bool(off.settings)
    assert off.settings or off.replaced
    with switched_off(off):
        assert all(pkgutil.resolve_name(name) is value for name, value in off.replaced.items())
    assert all(pkgutil.resolve_name(name) is not value for name, value in off.replaced.items())


@pytest.fixture
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """One drive, of a few poses."""
    (tmp_path / "robots" / "tiny").mkdir(parents=True)
    files = TextDrive.make(tmp_path / "robots" / "tiny").files()
    files["odometry"].rename(files["odometry"].with_name("odometry.tum"))
    files["ground_truth"].rename(files["ground_truth"].with_name("groundtruth.tum"))
    monkeypatch.setattr(ablation_drives, "DRIVES", {
        "tiny": lambda log, data: ablation_drives._write_robot(log, data, name="tiny")
    })  # fmt: skip
    return tmp_path


@pytest.mark.slow
def test_table_has_a_row_for_each_part_and_its_finished_copies_are_kept(dslam: Run, data: Path) -> None:
    """Also of a part that no setting switches off."""
    arguments = ("benchmark", "ablation", data, "-o", data / "out", "--copies", 2, "--jobs", 1)
    parts = ("--part", "existence of landmarks")
    result = dslam(*arguments, *parts, "--markdown")
    rows = [line.split(" | ")[:2] for line in result.out.splitlines() if line.startswith("| tiny")]
    assert rows == [["| tiny", f"off={DEFAULT} (2 runs)"], ["| tiny", "off=existence of landmarks (2 runs)"]]
    assert "2 copies with the noise" in result.out
    cells = {path: path.stat().st_mtime_ns for path in (data / "out" / "tiny" / "cells").glob("*.json")}
    assert len(cells) == 4
    groups = json.loads(dslam(*arguments, *parts, "--json").out)["tiny"]["groups"]
    assert list(groups) == [f"off={DEFAULT}", "off=existence of landmarks"]
    assert cells == {path: path.stat().st_mtime_ns for path in cells}


def test_unknown_names_are_refused(dslam: Run, tmp_path: Path) -> None:
    command = ("benchmark", "ablation", tmp_path, "-o", tmp_path / "out")
    assert_refused(dslam(*command, "--drive", "nowhere"), "no 'nowhere'", "kitti00")
    assert_refused(dslam(*command, "--part", "wheels"), "no 'wheels'", "calibration")
