"""Inputs as people bring them, and the sentence that each prints: read, or refused in one line with the remedy.

What single readers refuse is tested with these; here is what only the whole program notices.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from logs.messages import Transform
from tests.tools.runs import Run, write_drive

pytestmark = pytest.mark.slow

POSES = "".join(f"{90000 * t} {t} 0 0 0 0 0 1\n" for t in range(10))
TABLE = "stamp_s,x_m,y_m,label\n" + "".join(f"{90000 * t},{5 - t},2.0,tree\n" for t in range(10))
"""Stamps in milliseconds."""
MAP = "x_m,y_m,label\n0,0,tree\n5,0,tree\n0,7,pole\n6,8,tree\n"
GRID = "x_m,y_m\n385000,6670000\n385005,6670000\n385000,6670007\n385006,6670008\n"
PLACES = "lat,lon,label\n60.1,24.9,tree\n60.1001,24.9,tree\n60.1,24.9002,pole\n60.1002,24.9001,tree\n"


@dataclass(frozen=True)
class Case:
    """``told`` is printed by the ``command``; ``code``: 0 if the input is read."""

    told: str
    command: str
    files: Mapping[str, str | Callable[[Path], object]]
    code: int = 0


def places(told: str, text: str, *options: str, code: int = 0) -> Case:
    return Case(told, " ".join(["import map map.mcap --file objects.csv", *options]), {"objects.csv": text}, code)


def drive(told: str, *, code: int = 0, **made: Any) -> Case:
    return Case(told, "replay drive.mcap -o out.mcap", {"drive.mcap": partial(write_drive, **made)}, code)


CASES = {
    "stamps in milliseconds": Case(
        "give the stamps in seconds, or name the column by its unit",
        "import csv drive.mcap --odometry odometry.txt --detections t.csv",
        {"odometry.txt": POSES, "t.csv": TABLE},
        code=2,
    ),
    "a map in metres": places("origin unknown: give --origin", MAP),
    "a map in degrees": places("origin 60.1", PLACES),
    "a national grid": places("national grid", GRID, "--origin", "60,24", code=2),
    "three objects": places("needs at least four", MAP.rpartition("6,8")[0], code=2),
    "a frame that is connected with another": drive(
        "(frames that belong together: base_link; lidar, mount)",
        code=2,
        frame_id="lidar",
        transforms=(Transform(0, "lidar", "mount", np.eye(4)),),
    ),
    "detections in the map of another program": drive(
        "30 scans with 30 objects", frame_id="map", transforms=(Transform(0, "map", "odom", np.eye(4)),)
    ),
    "no objects": drive(
        "not corrected, the trajectory is that of the odometry",
        positions=np.zeros((0, 3)),
        labels=(),
        scores=np.zeros(0),
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_awkward_input(dslam: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    case = CASES[name]
    monkeypatch.chdir(tmp_path)
    for file, content in case.files.items():
        if callable(content):
            content(tmp_path / file)
        else:
            (tmp_path / file).write_text(content)
    result = dslam(*case.command.split())
    text = " ".join(f"{result.out} {result.err}".split())
    assert result.code == case.code, text
    assert case.told in text
    assert case.code == 0 or result.err.count("\n") == 1  # one reason, once
    assert not list(tmp_path.glob("*.part"))
    assert case.code == 0 or sorted(each.name for each in tmp_path.iterdir()) == sorted(case.files)
