"""One simulated drive as protobuf, JSON, ROS 2, CSV and labelled clouds: one map, whatever it comes in."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from google.protobuf.json_format import MessageToJson

from logs.decoders.protobuf import DECODERS
from logs.importers.imported_log import write_imported_log
from logs.importers.text_log import read_text_log
from logs.messages import FloatArray, GroundTruthPose, ObjectDetections, Odometry
from logs.topics import Channel, Schema
from logs.validation import quaternion_xyzw
from logs.writer import LogWriter
from slam.common.config import Config
from slam.common.geometry import transform_from_xyz_yaw
from slam.evaluation.evaluate import evaluate
from slam.evaluation.inputs.records import read_records
from slam.replay import replay
from slam.simulation.config import DriveConfig, SimulationConfig
from tests.helpers.ray_casting import GROUND, Solid, beams, cast
from tests.helpers.ros2_logs import Message, header, ros2_messages, write_bag
from tests.helpers.short_drives import Entry, block_world, drive, keep_until, raw_messages, records_of, write_log

SECONDS = 25.0
SIZES = {"bench": (1.8, 0.6, 0.9), "lamp": (0.2, 0.2, 5.0), "tree": (0.4, 0.4, 4.0), "vehicle": (2.0, 1.2, 1.4)}
ROUND = ("lamp", "tree")
NUMBERS = {"bench": 1, "lamp": 2, "tree": 3, "vehicle": 4}
LABELS = {"labels": {"rename": {str(n): name for name, n in NUMBERS.items()}, "drop": [str(GROUND)]}}
T_BODY_LIDAR = transform_from_xyz_yaw(np.array([0.0, 0.0, 1.7]), 0.0)


def as_json(source: Path, path: Path) -> Path:
    """The same log with every message in JSON."""
    with LogWriter(path) as writer:
        for raw in raw_messages(source):
            message = DECODERS[raw.channel.schema_name][0].FromString(raw.data)
            schema = Schema(1, raw.channel.schema_name, "jsonschema", b"{}")
            channel = Channel(raw.channel.id, raw.topic, "json", schema)
            writer.write_raw(replace(raw, channel=channel, data=MessageToJson(message).encode()))
    return path


def as_csv(entries: list[Entry], folder: Path) -> Path:
    """The same drive from a file of poses and a table."""
    folder.mkdir()
    poses, rows = list[str](), ["stamp_ns,frame,label,x_m,y_m,z_m,score"]
    for _, _, record in entries:
        if isinstance(record, Odometry):
            numbers = [*record.T_odom_body[:3, 3].tolist(), *quaternion_xyzw(record.T_odom_body)]
            stamp = f"{record.stamp_ns // 10**9}.{record.stamp_ns % 10**9:09d}"
            poses.append(" ".join([stamp, *map(repr, numbers)]))
        elif isinstance(record, ObjectDetections):
            start = f"{record.stamp_ns},{record.frame_id}"
            for label, xyz, score in zip(record.labels, record.positions.tolist(), record.scores.tolist(), strict=True):
                rows.append(",".join([start, label, *map(repr, xyz), repr(score)]))
            if not record.labels:
                rows.append(f"{start},,,,,")
    (folder / "odometry.tum").write_text("\n".join(poses) + "\n")
    (folder / "detections.csv").write_text("\n".join(rows) + "\n")
    output = folder / "drive.mcap"
    text = read_text_log(odometry=folder / "odometry.tum", detections=folder / "detections.csv")
    write_imported_log(output, text.records(), text.source)
    return output


@pytest.mark.slow
def test_one_drive_in_four_encodings_is_one_map(tmp_path: Path) -> None:
    entries = keep_until(drive(), SECONDS)
    protobuf = write_log(tmp_path / "drive.mcap", entries)
    bag = write_bag(tmp_path / "bag", ros2_messages(entries), storage="sqlite3")
    maps = []
    for source in (protobuf, as_json(protobuf, tmp_path / "json.mcap"), bag, as_csv(entries, tmp_path / "csv")):
        replay(source, tmp_path / "out.mcap", Config())
        maps.append(records_of(tmp_path / "out.mcap", "/slam/map")[-1])
    for other in maps[1:]:
        assert other.labels == maps[0].labels
        assert other.states == maps[0].states
        np.testing.assert_allclose(other.positions[:, :2], maps[0].positions[:, :2], atol=1e-9)
        # Heights follow from the tilt, which is held so firmly that rounding of the solution shows.
        np.testing.assert_allclose(other.positions[:, 2], maps[0].positions[:, 2], atol=1e-7)
    assert maps[0].states.count("confirmed") > 10


def solids() -> list[Solid]:
    """The objects of the world as boxes and poles, those beside the street turned along it."""
    world = block_world()
    found = []
    for label, (x, y, _) in zip(world.labels, world.positions.tolist(), strict=True):
        found.append(Solid(NUMBERS[label], x, y, SIZES[label], is_round=label in ROUND))
    return found


def as_clouds(entries: list[Entry]) -> list[Message]:
    """The same drive with a LiDAR in the place of the detector."""
    truth = {record.stamp_ns: record.T_world_body for _, _, record in entries if isinstance(record, GroundTruthPose)}
    rng, directions, world = np.random.default_rng(4), beams(), solids()
    found: list[Message] = []
    for entry in entries:
        record = entry[2]
        if isinstance(record, ObjectDetections):
            points, classes = cast(world, truth[record.stamp_ns] @ T_BODY_LIDAR, directions, rng=rng)
            values = point_cloud(record.stamp_ns, "lidar", points, classes)
            found.append(("/points", "sensor_msgs/msg/PointCloud2", entry[1], values))
        elif isinstance(record, (Odometry, GroundTruthPose)):
            found += ros2_messages([entry])
    transform = {"translation": dict(zip("xyz", T_BODY_LIDAR[:3, 3], strict=True)), "rotation": {"w": 1.0}}
    placed = {"header": header(found[0][2], "base_link"), "child_frame_id": "lidar", "transform": transform}
    found.append(("/tf_static", "tf2_msgs/msg/TFMessage", found[0][2], {"transforms": [placed]}))
    return sorted(found, key=lambda message: message[2])


def point_cloud(stamp_ns: int, frame: str, points: FloatArray, classes: np.ndarray) -> dict[str, Any]:
    """A PointCloud2 with the fields x, y, z, intensity and label."""
    rows = np.zeros(len(points), [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("label", "<u2")])
    for axis, name in enumerate("xyz"):
        rows[name] = points[:, axis]
    rows["label"] = classes
    fields = [{"name": name, "offset": 4 * i, "datatype": 7, "count": 1} for i, name in enumerate(rows.dtype.names[:4])]
    fields.append({"name": "label", "offset": 16, "datatype": 4, "count": 1})
    return {
        "header": header(stamp_ns, frame),
        "height": 1,
        "width": len(rows),
        "fields": fields,
        "point_step": rows.itemsize,
        "row_step": rows.nbytes,
        "data": np.frombuffer(rows.tobytes(), np.uint8),
    }


@pytest.mark.slow
def test_labelled_clouds_of_a_drive_map_it_as_well_as_its_detections(tmp_path: Path) -> None:
    simulation = SimulationConfig(drive=DriveConfig(rate_hz=5.0))
    entries = drive(simulation)
    bag = write_bag(tmp_path / "bag", as_clouds(entries))
    config = Config.model_validate(LABELS)
    replay(write_log(tmp_path / "drive.mcap", entries), tmp_path / "out.mcap", Config())
    replay(bag, tmp_path / "clouds.mcap", config, topics={"detections": "/points"})
    first, second = (evaluate(read_records(tmp_path / name)) for name in ("out.mcap", "clouds.mcap"))
    assert first.estimate is not None
    assert second.estimate is not None
    assert second.estimate.absolute.rmse_m <= 1.3 * first.estimate.absolute.rmse_m
    found = records_of(tmp_path / "clouds.mcap", "/slam/map")[-1]
    assert set(found.labels) == set(NUMBERS)
    assert found.states.count("confirmed") > 20
