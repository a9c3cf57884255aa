"""Inputs as people bring them, and the sentence that each prints: read, or refused in one line with the remedy."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from dslam import Config, LogError, Slam
from logs.messages import ObjectDetections, Odometry, Record, Transform
from logs.writer import LogWriter
from tests.tools.runs import Result, Run

POSES = "".join(f"{second} {second} 0 0 0 0 0 1\n" for second in range(10))
"""TUM: a metre a second along x."""
ROWS = [(second, 5 - second, 2.0) for second in range(10)]
TABLE = "stamp_s,x_m,y_m,label\n" + "".join(f"{t},{x},{y},tree\n" for t, x, y in ROWS)
DATES = "time,x_m,y_m,yaw\n" + "".join(f"2024-05-01T12:00:{second:02d}Z,{second},0,0\n" for second in range(10))
MAP = "x_m,y_m,label\n0,0,tree\n5,0,tree\n0,7,pole\n6,8,tree\n"
GRID = "x_m,y_m\n385000,6670000\n385005,6670000\n385000,6670007\n385006,6670008\n"
PLACES = "lat,lon,label\n60.1,24.9,tree\n60.1001,24.9,tree\n60.1,24.9002,pole\n60.1002,24.9001,tree\n"


@dataclass(frozen=True)
class Text:
    """``dslam import`` of text files: ``told`` is printed; ``code``: 0 if it is read."""

    told: str
    code: int = 2
    detections: str = TABLE
    odometry: str = POSES
    options: tuple[str, ...] = ()


TEXTS = {
    "a column that looks like a label": Text(
        "columns left out: kind_of_thing", 0, TABLE.replace("label", "kind_of_thing")
    ),
    "labels in Chinese": Text("10 objects detected", 0, TABLE.replace("tree", "路灯")),
    "ISO 8601": Text(
        "10 objects detected",
        0,
        "time,x_m,y_m\n" + "".join(f"2024-05-01T12:00:{t:02d}Z,{x},{y}\n" for t, x, y in ROWS),
        DATES,
    ),
    "datetimes of pandas": Text(
        "10 objects detected",
        0,
        "time,x_m,y_m\n" + "".join(f"2024-05-01 12:00:{t:02d}+00:00,{x},{y}\n" for t, x, y in ROWS),
        DATES,
    ),
    "dates in a path without a header": Text(
        "or a first line that names the columns", odometry=DATES.partition("\n")[2]
    ),
    "line ends of Windows": Text("10 objects detected", 0, TABLE.replace("\n", "\r\n")),
    "a byte order mark": Text("10 objects detected", 0, "\ufeff" + TABLE),
    "decimal commas": Text("write it with a decimal point", detections=TABLE.replace(",", ";").replace("2.0", "2,0")),
    "no header": Text("detections.csv", detections=TABLE.partition("\n")[2]),
    "stamps that go backwards": Text(
        "0.5 comes after a later stamp; sort the lines", detections=TABLE + "0.5,1,1,tree\n"
    ),
    "stamps in milliseconds": Text(
        "give the stamps in seconds, or call the column by its unit",
        odometry="".join(f"{90000 * t} {t} 0 0 0 0 0 1\n" for t in range(10)),
        detections="stamp_s,x_m,y_m\n" + "".join(f"{90000 * t},{x},{y}\n" for t, x, y in ROWS),
    ),
    "another clock": Text("outside", detections="".join(TABLE.replace("\n", "\n17")[:-2])),
    "degrees as metres": Text(
        "no column for x among stamp_s, lat, lon", detections=TABLE.replace("x_m,y_m", "lat,lon")
    ),
}


@pytest.mark.parametrize("name", TEXTS)
def test_import_of_text_files(dslam: Run, tmp_path: Path, name: str) -> None:
    case = TEXTS[name]
    (tmp_path / "detections.csv").write_text(case.detections, encoding="utf-8", newline="")
    (tmp_path / "odometry.tum").write_text(case.odometry, encoding="utf-8")
    files = ("--odometry", tmp_path / "odometry.tum", "--detections", tmp_path / "detections.csv")
    check(dslam("import", "csv", tmp_path / "drive.mcap", *files, *case.options), case.code, case.told)
    assert (tmp_path / "drive.mcap").exists() == (case.code == 0)
    assert not (tmp_path / "drive.mcap.part").exists()


@pytest.mark.parametrize(
    ("damage", "code", "told"),
    [
        (slice(None), 0, "10 objects detected"),
        (slice(0, 60), 2, "cannot be read as Parquet"),
        (None, 2, "need pyarrow"),
    ],
)
def test_import_of_parquet(
    dslam: Run, tmp_path: Path, damage: slice | None, code: int, told: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("pyarrow", reason="pyarrow is not installed")
    start = pd.Timestamp("2024-05-01T12:00:00Z")
    rows = [(start + pd.Timedelta(seconds=t), x, y, "tree") for t, x, y in ROWS]
    path = tmp_path / "detections.parquet"
    pd.DataFrame(rows, columns=["time", "x_m", "y_m", "label"]).to_parquet(path)
    path.write_bytes(path.read_bytes()[damage or slice(None)])
    if damage is None:
        monkeypatch.setitem(sys.modules, "pyarrow", None)
    (tmp_path / "odometry.csv").write_text(DATES, encoding="utf-8")
    files = ("--odometry", tmp_path / "odometry.csv", "--detections", path)
    check(dslam("import", "csv", tmp_path / "drive.mcap", *files), code, told)


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


MALFORMED: dict[str, tuple[Record, str]] = {
    "a scaled rotation": (Odometry(0, np.diag([2.0, 2.0, 2.0, 1.0])), "not a rotation"),
    "a mirrored rotation": (Odometry(0, np.diag([1.0, -1.0, 1.0, 1.0])), "not a rotation"),
    "a transposed transform": (Odometry(0, np.eye(4) + np.eye(4, k=-3)), "a transform maps columns"),
    "seconds for nanoseconds": (Odometry(1.5, np.eye(4)), "whole number of nanoseconds"),
    "positions in the plane": (
        ObjectDetections(0, "base_link", np.ones((1, 2)), ("tree",), np.ones(1)),
        "give a float64 array of shape (1, 3)",
    ),
    "a list of positions": (
        ObjectDetections(0, "base_link", [[1, 2, 3]], ("tree",), np.ones(1)),
        "list; give a float64",
    ),
    "labels as one text": (ObjectDetections(0, "base_link", np.ones((1, 3)), "tree", np.ones(1)), "not a tuple"),
}


@pytest.mark.parametrize("name", MALFORMED)
def test_records_of_programs(name: str) -> None:
    record, told = MALFORMED[name]
    with pytest.raises(LogError) as caught:
        Slam(Config()).process(record)
    assert told in str(caught.value)
