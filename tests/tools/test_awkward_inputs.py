"""Inputs as people bring them, and the sentence that each prints: read, or refused in one line with the remedy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from logs.messages import ObjectDetections, Odometry, Transform
from logs.writer import LogWriter
from tests.tools.runs import Result, Run

MAP = "x_m,y_m,label\n0,0,tree\n5,0,tree\n0,7,pole\n6,8,tree\n"
GRID = "x_m,y_m\n385000,6670000\n385005,6670000\n385000,6670007\n385006,6670008\n"
PLACES = "lat,lon,label\n60.1,24.9,tree\n60.1001,24.9,tree\n60.1,24.9002,pole\n60.1002,24.9001,tree\n"


LOOP = Transform(0, "lidar", "lidar_mount", np.eye(4))
EMPTY = {"positions": np.zeros((0, 3)), "labels": (), "scores": np.zeros(0)}
UNCONNECTED = {"frame_id": "lidar"}
LATER = {"delay_ns": 10**15}


@pytest.mark.parametrize(
    ("command", "changed", "code", "told"),
    [
        ("replay", UNCONNECTED, 2, "lidar"),
        ("replay", {**UNCONNECTED, "transform": LOOP}, 2, "lidar_mount"),
        ("replay", EMPTY, 0, "not corrected, the trajectory is that of the odometry"),
        ("replay", LATER, 0, "check that both have the same clock"),
        ("info", LATER, 0, "not on one clock"),
        ("info", UNCONNECTED, 0, "which no transform connects with base_link"),
    ],
)
def test_logs(dslam: Run, tmp_path: Path, command: str, changed: Mapping[str, Any], code: int, told: str) -> None:
    """Odometry and a tree at 5 m in each scan, of which some things are changed."""
    detections = dict(changed)
    transform, delay_ns = detections.pop("transform", None), detections.pop("delay_ns", 0)
    with LogWriter(tmp_path / "drive.mcap") as log:
        if transform is not None:
            log.write("/tf_static", transform)
        for stamp_ns in range(0, 3 * 10**9, 10**8):
            T_odom_body = np.eye(4)
            T_odom_body[0, 3] = stamp_ns * 1e-9
            log.write("/odom", Odometry(stamp_ns, T_odom_body))
            scan = ObjectDetections(stamp_ns + delay_ns, "base_link", np.ones((1, 3)), ("tree",), np.ones(1))
            log.write("/objects", replace(scan, **detections), stamp_ns)
    output = ("-o", tmp_path / "out.mcap") if command == "replay" else ()
    check(dslam(command, tmp_path / "drive.mcap", *output), code, told)
    assert not list(tmp_path.glob("*.part"))


MAPS = {
    "a table in metres": (MAP, (), 0, "origin unknown: give --origin"),
    "a table in degrees": (PLACES, (), 0, "origin at latitude 60.1"),
    "degrees called metres": (PLACES.replace("lat,lon", "x_m,y_m"), (), 2, "call the columns lat and lon"),
    "a national grid": (GRID, ("--origin", "60,24"), 2, "national grid"),
    "three objects": (MAP.rpartition("6,8")[0], (), 2, "needs at least four"),
}


@pytest.mark.parametrize("name", MAPS)
def test_import_of_maps(dslam: Run, tmp_path: Path, name: str) -> None:
    text, options, code, told = MAPS[name]
    (tmp_path / "objects.csv").write_text(text, encoding="utf-8")
    check(dslam("import", "map", tmp_path / "map.mcap", "--file", tmp_path / "objects.csv", *options), code, told)
    assert (tmp_path / "map.mcap").exists() == (code == 0)


def check(result: Result, code: int, told: str) -> None:
    text = " ".join(f"{result.out} {result.err}".split())
    assert result.code == code, text
    assert told in text, text
    assert code == 0 or result.err.count("\n") == 1
