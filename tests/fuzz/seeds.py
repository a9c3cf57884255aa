"""Whole and valid files of every format, from which the fuzzer goes out."""

from __future__ import annotations

import contextlib
import io
import json
import shutil
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path

import numpy as np
from google.protobuf.json_format import MessageToDict

from logs.decoders.protobuf import DECODERS
from logs.reader import LogReader
from logs.writer import LogWriter
from tests.fuzz.dataset_cases import NETWORKS, make_trainings_small, training_arguments
from tests.fuzz.mcap_file import McapFile, Message, read_file
from tests.helpers.ros2_logs import Message as RosMessage
from tests.helpers.ros2_logs import at, detection3d, encoded, header, tf, write_bag
from tests.logs.examples import every_kind
from tests.tools.runs import SAMPLE
from tools import cli

_SECONDS = 2.0
WEIGHTS = Path(str(resources.files("descriptors"))) / "weights" / "descriptellation_lr.safetensors"


@dataclass(frozen=True)
class Seeds:
    """Logs by name, the bytes of other files by name, those of a bag, and checkpoints by the folder of a training."""

    logs: dict[str, McapFile]
    files: dict[str, bytes]
    bag: dict[str, bytes]
    trainings: dict[str, bytes]


def make_seeds(folder: Path) -> Seeds:
    """Make them in ``folder``, a few seconds; trainings of this process are small from then on."""
    make_trainings_small()
    drive, mapped, saved = folder / "drive.mcap", folder / "mapped.mcap", folder / "map.mcap"
    _write_drive(drive)
    _run("replay", drive, "-o", mapped, "--save-map", saved)
    _run("export", mapped, "--tum", folder / "trajectory.tum", "--g2o", folder / "map.g2o")
    _run("export", mapped, "--kitti", folder / "trajectory.kitti")
    rows = (folder / "trajectory.tum").read_text().splitlines()
    (folder / "times.txt").write_text("\n".join(row.partition(" ")[0] for row in rows))
    _write_kinds(folder / "kinds.mcap")
    _write_ros(folder / "ros.mcap")
    (folder / "settings.toml").write_text(_run("config"))
    (folder / "simulation.toml").write_text(_run("config", "--simulation"))
    (folder / "detections.csv").write_text(_detections_table(drive))
    _run("export", mapped, "--csv", folder / "objects.csv")
    _write_objects(folder)
    names = ("drive", "mapped", "map", "kinds", "ros")
    texts = ("trajectory.tum", "trajectory.kitti", "times.txt", "settings.toml", "simulation.toml", "detections.csv",
             "objects.csv", "objects.geojson", "objects.osm", WEIGHTS.name)  # fmt: skip
    shutil.copy(WEIGHTS, folder)
    logs = {name: read_file(str(folder / f"{name}.mcap")) for name in names}
    return Seeds(
        logs={**logs, "json": _as_json(logs["drive"])},
        files={name: (folder / name).read_bytes() for name in texts},
        bag={path.name: path.read_bytes() for path in _write_bag(folder).iterdir()},
        trainings={name: _checkpoint(folder, name) for name in NETWORKS},
    )


def _write_bag(folder: Path) -> Path:
    with LogReader(folder / "ros.mcap") as reader:
        return write_bag(folder / "bag", list(reader.messages()), storage="sqlite3")


def _checkpoint(folder: Path, name: str) -> bytes:
    with contextlib.chdir(folder):
        _run(*training_arguments(name))
    return (folder / name / "checkpoint.pt").read_bytes()


def _run(*arguments: object) -> str:
    with contextlib.redirect_stdout(io.StringIO()) as out:
        code = cli.run([str(argument) for argument in arguments])
    if code != 0:
        raise RuntimeError(f"a seed cannot be made: dslam {arguments} ends with {code}")
    return out.getvalue()


def _write_drive(path: Path) -> None:
    with LogReader(SAMPLE) as reader, LogWriter(path) as writer:
        for name, values in reader.metadata().items():
            writer.add_metadata(name, values)
        first_ns = None
        for raw in reader.messages():
            first_ns = raw.log_time_ns if first_ns is None else first_ns
            if raw.log_time_ns - first_ns < _SECONDS * 1e9:
                writer.write_raw(raw)


def _as_json(file: McapFile) -> McapFile:
    """The same log with messages and schemas of JSON."""
    altered = file.copy()
    altered.schemas = {id: (name, "jsonschema", b"{}") for id, (name, _, _) in file.schemas.items()}
    altered.channels = {id: (schema, topic, "json") for id, (schema, topic, _) in file.channels.items()}
    altered.messages = [replace(each, data=_json(file, each)) for each in file.messages]
    return altered


def _json(file: McapFile, message: Message) -> bytes:
    name = file.schemas[file.channels[message.channel][0]][0]
    content = DECODERS[name].message_class.FromString(message.data)
    return json.dumps(MessageToDict(content, preserving_proto_field_name=True)).encode()


def _write_objects(folder: Path) -> None:
    """The same objects as GeoJSON and as an extract of OpenStreetMap."""
    rng = np.random.default_rng(5)
    places = rng.uniform([24.90, 60.10], [24.91, 60.11], size=(30, 2)).round(6).tolist()
    features = [
        {"type": "Feature", "properties": {"class": "tree", "id": number},
         "geometry": {"type": "Point", "coordinates": place}}
        for number, place in enumerate(places)
    ]  # fmt: skip
    (folder / "objects.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    nodes = [
        f'<node id="{number}" lat="{latitude}" lon="{longitude}"><tag k="natural" v="tree"/></node>'
        for number, (longitude, latitude) in enumerate(places, start=1)
    ]
    (folder / "objects.osm").write_text("\n".join(['<?xml version="1.0"?>', '<osm version="0.6">', *nodes, "</osm>"]))


def _write_kinds(path: Path) -> None:
    with LogWriter(path) as writer:
        for topic, _, record in every_kind(np.random.default_rng(3)):
            writer.write(topic, record)


def _write_ros(path: Path) -> None:
    """The same drive as MCAP with messages of ROS 2."""
    rng = np.random.default_rng(4)
    objects = rng.uniform(-20.0, 20.0, size=(30, 3)) * (1.0, 1.0, 0.05)
    mounted = np.eye(4)
    mounted[2, 3] = 1.0
    messages: list[RosMessage] = []
    for i in range(20):
        x, now = 0.3 * i, 10**12 + i * 10**8
        placed = {"pose": at(x, 0.0, 0.0), "covariance": 0.01 * np.eye(6)}
        odometry = {"header": header(now, "odom"), "child_frame_id": "base_link", "pose": placed}
        seen = [detection3d(p - (x, 0.0, 0.0), f"class {k % 4}", 0.9, id=str(k)) for k, p in enumerate(objects)]
        scan = {"header": header(now, "base_link"), "detections": seen}
        messages.append(("/odom", "nav_msgs/msg/Odometry", now, odometry))
        messages.append(("/objects", "vision_msgs/msg/Detection3DArray", now, scan))
        frames = {"transforms": [tf(now, "base_link", "lidar", mounted)]}
        messages.append(("/tf", "tf2_msgs/msg/TFMessage", now, frames))
    with LogWriter(path) as writer:
        for message in messages:
            writer.write_raw(encoded(message))


def _detections_table(drive: Path) -> str:
    from logs.messages import ObjectDetections
    from logs.selection import select_topics

    lines = ["stamp_s,x_m,y_m,z_m,label,score,track_id"]
    with LogReader(drive) as reader:
        for entry in reader.records(select_topics(reader.topics())):
            if isinstance(entry.record, ObjectDetections):
                record = entry.record
                for (x, y, z), label in zip(record.positions.tolist(), record.labels, strict=True):
                    lines.append(f"{record.stamp_ns * 1e-9!r},{x!r},{y!r},{z!r},{label},0.9,7")
    return "\n".join(lines) + "\n"
