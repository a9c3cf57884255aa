"""Inputs as people bring them, and the sentence that each prints: read, or refused in one line with the remedy."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags import rosbag1 as ros1

from logs.messages import ObjectDetections, Odometry, Transform
from logs.topics import Channel, RawMessage, Schema
from logs.writer import LogWriter
from tests.helpers.ros2_logs import Message, detections3d, header, pose, write_ros1_bag
from tests.tools.runs import SAMPLE, Run

pytestmark = pytest.mark.slow

SECONDS = range(10)
POSES = "".join(f"{t} {t} 0 0 0 0 0 1\n" for t in SECONDS)
"""TUM: a metre a second along x."""
TABLE = "stamp_s,x_m,y_m,label\n" + "".join(f"{t},{5 - t},2.0,tree\n" for t in SECONDS)
ISO = {t: f"2024-05-01T12:00:{t:02d}Z" for t in SECONDS}
PANDAS = {t: f"2024-05-01 14:00:{t:02d}.000000+02:00" for t in SECONDS}
DATED_POSES = "time,x_m,y_m,yaw\n" + "".join(f"{ISO[t]},{t},0,0\n" for t in SECONDS)
MAP = "x_m,y_m,label\n0,0,tree\n5,0,tree\n0,7,pole\n6,8,tree\n"
GRID = "x_m,y_m\n385000,6670000\n385005,6670000\n385000,6670007\n385006,6670008\n"
PLACES = "lat,lon,label\n60.1,24.9,tree\n60.1001,24.9,tree\n60.1,24.9002,pole\n60.1002,24.9001,tree\n"


def dated(stamps: Mapping[int, str]) -> str:
    return "time,x_m,y_m,label\n" + "".join(f"{stamps[t]},{5 - t},2.0,tree\n" for t in SECONDS)


def in_milliseconds(text: str, separator: str) -> str:
    rows = (line.partition(separator) for line in text.splitlines())
    return "".join(f"{90000 * int(t)}{separator}{rest}\n" if t.isdigit() else f"{t},{rest}\n" for t, _, rest in rows)


@dataclass(frozen=True)
class Drive:
    """Odometry and a tree at 5 m in each scan, of which some things are ``changed``."""

    changed: Mapping[str, Any] = field(default_factory=dict)
    transforms: tuple[Transform, ...] = ()
    delay_ns: int = 0
    odometry: tuple[str, ...] = ("/odom",)
    json: str = ""

    def __call__(self, path: Path) -> None:
        own = Channel(9, "/plants", "json", Schema(9, "Plants", "jsonschema", b"{}"))
        with LogWriter(path) as log:
            for transform in self.transforms:
                log.write("/tf_static", transform)
            for stamp_ns in range(0, 3 * 10**9, 10**8):
                T_odom_body = np.eye(4)
                T_odom_body[0, 3] = stamp_ns * 1e-9
                for topic in self.odometry:
                    log.write(topic, Odometry(stamp_ns, T_odom_body))
                at = np.array([[5.0 - stamp_ns * 1e-9, 2.0, 1.0]])
                scan = ObjectDetections(stamp_ns + self.delay_ns, "base_link", at, ("tree",), np.ones(1))
                if self.json:
                    log.write_raw(RawMessage(own, stamp_ns, stamp_ns, 0, self.json.encode()))
                else:
                    log.write("/objects", replace(scan, **self.changed), stamp_ns)


def ros1_bag(path: Path) -> None:
    messages: list[Message] = []
    for stamp_ns in range(0, 3 * 10**9, 10**8):
        scan = ObjectDetections(stamp_ns, "base_link", np.ones((1, 3)), ("tree",), np.ones(1))
        odometry = {
            "header": header(stamp_ns, "odom"),
            "child_frame_id": "base_link",
            "pose": {"pose": pose(np.eye(4))},
        }
        messages += [("/odom", "nav_msgs/msg/Odometry", stamp_ns, odometry)]
        messages += [("/objects", "vision_msgs/msg/Detection3DArray", stamp_ns, detections3d(scan))]
    write_ros1_bag(path, messages, ros1.Writer.CompressionFormat.LZ4)


File = str | bytes | Callable[[Path], None]


@dataclass(frozen=True)
class Case:
    """``told`` is printed by the last of the ``commands``; ``code``: 0 if the input is read."""

    told: str
    commands: str
    files: Mapping[str, File]
    code: int = 0


def table(told: str, detections: str = TABLE, odometry: str = POSES, *, code: int = 0) -> Case:
    commands = "import csv drive.mcap --odometry odometry.txt --detections t.csv"
    if code == 0:
        commands += "; info drive.mcap"
    return Case(told, commands, {"odometry.txt": odometry, "t.csv": detections}, code)


def places(told: str, text: str, *options: str, code: int = 0) -> Case:
    return Case(told, " ".join(["import map map.mcap --file objects.csv", *options]), {"objects.csv": text}, code)


def drive(
    told: str, made: File, command: str = "replay {} -o out.mcap", code: int = 0, name: str = "drive.mcap"
) -> Case:
    return Case(told, command.format(name), {name: made}, code)


PLANTS = json.dumps({"plants": [{"kind": "tree", "sure": 0.5, "at": {"x": 5, "y": 2}}]})
CASES = {
    "a column that looks like a label": table(
        "no column label, but object_class; name the column with the classes label",
        TABLE.replace("label", "object_class"),
        code=2,
    ),
    "datetimes of pandas": table("objects tree 10", dated(PANDAS), DATED_POSES),
    "labels in Chinese": table("objects 路灯 10", TABLE.replace("tree", "路灯")),
    "a file of Windows": table("objects tree 10", "\ufeff" + TABLE.replace("\n", "\r\n")),
    "stamps that go backwards": table(
        "0.5 comes after a later stamp; sort the lines by this column", TABLE + "0.5,1,1,tree\n", code=2
    ),
    "stamps in milliseconds": table(
        "give the stamps in seconds, or name the column by its unit",
        in_milliseconds(TABLE, ","),
        in_milliseconds(POSES, " "),
        code=2,
    ),
    "scores in percent": table(
        "95 is not in [0, 1]; scale the scores to [0, 1]", TABLE.replace("label", "score").replace("tree", "95"), code=2
    ),
    "a map in metres": places("origin unknown: give --origin", MAP),
    "a map in degrees": places("origin at latitude 60.1", PLACES),
    "degrees called metres": places("name the columns lat and lon", PLACES.replace("lat,lon", "x_m,y_m"), code=2),
    "a national grid": places("national grid", GRID, "--origin", "60,24", code=2),
    "three objects": places("needs at least four", MAP.rpartition("6,8")[0], code=2),
    "a frame that nothing connects": drive(
        "no transform leads from lidar to base_link", Drive({"frame_id": "lidar"}), code=2
    ),
    "a frame that is connected with another": drive(
        "(frames that belong together: base_link; lidar, mount)",
        Drive({"frame_id": "lidar"}, (Transform(0, "lidar", "mount", np.eye(4)),)),
        code=2,
    ),
    "detections in the map of another program": drive(
        "30 scans with 30 objects", Drive({"frame_id": "map"}, (Transform(0, "map", "odom", np.eye(4)),))
    ),
    "no objects": drive(
        "not corrected, the trajectory is that of the odometry",
        Drive({"positions": np.zeros((0, 3)), "labels": (), "scores": np.zeros(0)}),
    ),
    "covariances of zeros": drive("30 scans with 30 objects", Drive({"covariances": np.zeros((1, 3, 3))})),
    "another clock": drive("check that both have the same clock", Drive(delay_ns=10**15)),
    "another clock, in info": drive("not on one clock", Drive(delay_ns=10**15), "info {}"),
    "an unconnected frame, in info": drive(
        "which no transform connects with base_link", Drive({"frame_id": "lidar"}), "info {}"
    ),
    "messages of one's own": drive("'dslam info LOG' suggests them", Drive(json=PLANTS), code=2),
    "messages of one's own, in info": drive(
        "--topic 'detections=/plants:plants[] position=at label=kind'", Drive(json=PLANTS), "info {}"
    ),
    "a bag of ROS 1": drive("30 odometry messages, 30 scans with 30 objects", ros1_bag, name="drive.bag"),
    "a log that ends early": drive("truncated", SAMPLE.read_bytes()[:100_000]),
    "a result for a drive": drive("no topic gives odometry", Drive(odometry=()), code=2),
}


@pytest.mark.parametrize("name", CASES)
def test_awkward_input(dslam: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    case = CASES[name]
    monkeypatch.chdir(tmp_path)
    for file, content in case.files.items():
        if callable(content):
            content(tmp_path / file)
        else:
            (tmp_path / file).write_bytes(content if isinstance(content, bytes) else content.encode())
    for command in case.commands.split("; "):
        result = dslam(*command.split())
    text = " ".join(f"{result.out} {result.err}".split())
    assert result.code == case.code, text
    assert case.told in text
    assert case.code == 0 or result.err.count("\n") == 1  # one reason, once
    assert sorted(each.name for each in tmp_path.iterdir() if each.suffix == ".part") == []
    assert case.code == 0 or sorted(each.name for each in tmp_path.iterdir()) == sorted(case.files)
