"""ROS 2 recordings for tests: messages from plain values, and bags of every kind, written by ``rosbags``."""

import shutil
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from ruamel.yaml import YAML

from logs import messages as m
from logs.decoders.ros2_types import TYPES
from logs.topics import Channel, RawMessage, Schema
from logs.validation import quaternion_xyzw
from tests.helpers.short_drives import Entry

Message = tuple[str, str, int, dict[str, Any]]
"""Topic, type, log time, fields; those left out are zero."""


def make_message(type_name: str, values: Mapping[str, Any]) -> Any:
    """A message from its fields by name, those of messages within it likewise; what is left out is 0 or empty."""
    _, fields = TYPES.fielddefs[type_name]
    return TYPES.types[type_name](**{name: _make_field(kind, values.get(name)) for name, kind in fields})


def _make_field(kind: Any, value: Any) -> Any:
    node, detail = kind
    if node == Nodetype.NAME:
        return make_message(detail, value or {})
    if node == Nodetype.BASE:
        return value if value is not None else "" if detail[0] == "string" else 0
    (element, element_type), count = detail
    if element == Nodetype.NAME:
        return [make_message(element_type, each) for each in value or ()]
    dtype = np.uint8 if element_type[0] in ("octet", "byte") else element_type[0]
    return np.zeros(count, dtype) if value is None else np.array(value, dtype).ravel()


def cdr(type_name: str, values: dict[str, Any]) -> bytes:
    return bytes(TYPES.serialize_cdr(make_message(type_name, values), type_name))


def header(stamp_ns: int = 0, frame: str = "") -> dict[str, Any]:
    seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
    return {"stamp": {"sec": seconds, "nanosec": nanoseconds}, "frame_id": frame}


def vector(x: float, y: float, z: float) -> dict[str, float]:
    return {"x": float(x), "y": float(y), "z": float(z)}


def pose(T: np.ndarray) -> dict[str, Any]:
    q = quaternion_xyzw(T)
    return {"position": vector(*T[:3, 3]), "orientation": dict(zip("xyzw", q, strict=True))}


def at(x: float, y: float, z: float) -> dict[str, Any]:
    return {"position": vector(x, y, z), "orientation": {"w": 1.0}}


def tf(stamp_ns: int, parent: str, child: str, T: np.ndarray) -> dict[str, Any]:
    placed = pose(T)
    return {
        "header": header(stamp_ns, parent),
        "child_frame_id": child,
        "transform": {"translation": placed["position"], "rotation": placed["orientation"]},
    }


def detection3d(position: Sequence[float], label: str, score: float = 1.0, **fields: Any) -> dict[str, Any]:
    covariance = fields.pop("covariance", np.zeros((6, 6)))
    return {
        "results": [{"hypothesis": {"class_id": label, "score": score}, "pose": {"covariance": covariance}}],
        "bbox": {"center": at(*position), "size": vector(0.5, 0.5, 1.0)},
        **fields,
    }


def ros2_messages(entries: Iterable[Entry]) -> list[Message]:
    """A simulated drive as a robot with ROS 2 would record it."""
    found: list[Message] = []
    for topic, log_time_ns, record in entries:
        converted = _converted(topic, record)
        if converted is not None:
            found.append((converted[0], converted[1], log_time_ns, converted[2]))
    return found


def _converted(topic: str, record: m.Record) -> tuple[str, str, dict[str, Any]] | None:
    if isinstance(record, m.Odometry):
        fields = {
            "header": header(record.stamp_ns, record.frame_id),
            "child_frame_id": record.child_frame_id,
            "pose": {"pose": pose(record.T_odom_body)},
        }
        return "/odom", "nav_msgs/msg/Odometry", fields
    if isinstance(record, m.ObjectDetections):
        return "/detections", "vision_msgs/msg/Detection3DArray", detections3d(record)
    if isinstance(record, m.Transform):
        placed = tf(record.stamp_ns, record.parent_frame_id, record.child_frame_id, record.T_parent_child)
        return "/tf_static", "tf2_msgs/msg/TFMessage", {"transforms": [placed]}
    if isinstance(record, m.GroundTruthPose):
        fields = {"header": header(record.stamp_ns, record.frame_id), "pose": pose(record.T_world_body)}
        return "/ground_truth", "geometry_msgs/msg/PoseStamped", fields
    return None


def detections3d(record: m.ObjectDetections) -> dict[str, Any]:
    listed = []
    for i, label in enumerate(record.labels):
        covariance = np.zeros((6, 6))
        if record.covariances is not None:
            covariance[:3, :3] = record.covariances[i]
        listed.append(detection3d(record.positions[i], label, record.scores[i], covariance=covariance))
    return {"header": header(record.stamp_ns, record.frame_id), "detections": listed}


def encoded(message: Message) -> RawMessage:
    topic, type_name, log_time_ns, values = message
    definition = TYPES.generate_msgdef(type_name, ros_version=2)[0].encode()
    channel = Channel(topic, "cdr", Schema(type_name, "ros2msg", definition))
    return RawMessage(channel, log_time_ns, log_time_ns, 0, cdr(type_name, values))


def write_bag(
    folder: Path,
    messages: Sequence[Message] | Sequence[RawMessage],
    *,
    storage: str = "mcap",
    files: int = 1,
    compression: str = "none",
) -> Path:
    """A rosbag2 folder with ``messages`` split into ``files``; ``compression``: "none", "file" or "message"."""
    folder.mkdir(parents=True)
    names = []
    size = -(-len(messages) // files)
    for i in range(files):
        some = messages[i * size : (i + 1) * size]
        part = folder / f"part_{i}"
        writer = Writer(part, version=8, storage_plugin=StoragePlugin[storage.upper()])
        if compression != "none":
            writer.set_compression(CompressionMode[compression.upper()], CompressionFormat.ZSTD)
        with writer:
            connections: dict[str, Any] = {}
            for message in some:
                raw = message if isinstance(message, RawMessage) else encoded(message)
                if raw.topic not in connections:
                    schema = raw.channel.schema
                    connections[raw.topic] = writer.add_connection(
                        raw.topic, schema.name, msgdef=schema.data.decode(), rihs01=TYPES.hash_rihs01(schema.name)
                    )
                writer.write(connections[raw.topic], raw.log_time_ns, raw.data)
        yaml = YAML(typ="safe", pure=True)
        metadata = yaml.load(part / "metadata.yaml")
        (name,) = metadata["rosbag2_bagfile_information"]["relative_file_paths"]
        names.append(name)
        (part / name).rename(folder / name)
        shutil.rmtree(part)
    metadata["rosbag2_bagfile_information"]["relative_file_paths"] = names
    with open(folder / "metadata.yaml", "w") as stream:
        yaml.dump(metadata, stream)
    return folder
