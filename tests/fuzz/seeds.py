"""Whole and valid files of every format, from which the fuzzer goes out."""

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
from slam.simulation.config import SimulationConfig
from tests.fuzz.mcap_file import McapFile, Message, read_file
from tests.helpers.forked_commands import write_files
from tests.helpers.ros2_logs import encoded, ros2_messages, write_bag
from tests.helpers.short_drives import drive as drive_of
from tests.helpers.short_drives import keep_until, write_log, write_records
from tests.logs.examples import every_kind
from tests.logs.importers.test_centroids import FILES
from tests.logs.importers.text_drives import DETECTIONS
from tests.tools.runs import run_well

_SECONDS = 2.0
_KITTI = {
    **{f"centroids/{name}": text for name, text in FILES.items()},
    "poses.txt": "".join(f"1 0 0 0 0 1 0 0 0 0 1 {z}\n" for z in range(3)),
    "calib.txt": "P0: 0 0 0 0 0 0 0 0 0 0 0 0\nTr: 0 -1 0 0.1 0 0 -1 0.2 1 0 0 -0.3\n",
    "clock.txt": "0.000000e+00\n1.037359e-01\n2.05816123456789e-01\n",
}
WEIGHTS = Path(str(resources.files("descriptors"))) / "weights" / "descriptellation_lr.safetensors"


@dataclass(frozen=True)
class Seeds:
    """Logs by name, and the bytes of other files by name, "FOLDER/NAME" of those in a folder."""

    logs: dict[str, McapFile]
    files: dict[str, bytes]


def make_seeds(folder: Path) -> Seeds:
    """Make them in ``folder``, a few seconds."""
    drive, mapped, saved = folder / "drive.mcap", folder / "mapped.mcap", folder / "map.mcap"
    entries = keep_until(drive_of(SimulationConfig()), _SECONDS)
    write_log(drive, entries)
    run_well("replay", drive, "-o", mapped, "--save-map", saved)
    run_well("export", mapped, "--tum", folder / "trajectory.tum", "--kitti", folder / "trajectory.kitti")
    rows = (folder / "trajectory.tum").read_text().splitlines()
    (folder / "times.txt").write_text("\n".join(row.partition(" ")[0] for row in rows))
    (folder / "detections.csv").write_text(DETECTIONS)
    write_records(folder / "kinds.mcap", ((topic, each) for topic, _, each in every_kind(np.random.default_rng(3))))
    with LogWriter(folder / "ros.mcap") as writer:
        for message in ros2_messages(entries):
            writer.write_raw(encoded(message))
    (folder / "settings.toml").write_text(run_well("config"))
    (folder / "simulation.toml").write_text(run_well("config", "--simulation"))
    exported = ("--csv", folder / "objects.csv", "--geojson", folder / "objects.geojson", "--origin", "60.1,24.9")
    run_well("export", mapped, *exported)
    _write_extract(folder / "objects.osm")
    shutil.copy(WEIGHTS, folder)
    with LogReader(folder / "ros.mcap") as reader:
        write_bag(folder / "bag", list(reader.messages()))
    write_files(folder, {name: text.encode() for name, text in _KITTI.items()})
    logs = {name: read_file(str(folder / f"{name}.mcap")) for name in ("drive", "mapped", "map", "kinds", "ros")}
    found = {path.relative_to(folder).as_posix(): path for path in sorted(folder.rglob("*")) if path.is_file()}
    return Seeds(
        logs={**logs, "json": _as_json(logs["drive"])},
        files={name: path.read_bytes() for name, path in found.items() if name.removesuffix(".mcap") not in logs},
    )


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


def _write_extract(path: Path) -> None:
    """Trees as an extract of OpenStreetMap."""
    nodes = [
        f'<node id="{number}" lat="60.1{number:02d}" lon="24.9{number:02d}"><tag k="natural" v="tree"/></node>'
        for number in range(1, 31)
    ]
    path.write_text("\n".join(['<?xml version="1.0"?>', '<osm version="0.6">', *nodes, "</osm>"]))
