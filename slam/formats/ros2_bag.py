"""A mapped drive as a ROS 2 bag (rosbag2, SQLite, CDR), in messages of ROS that `ros2 bag play` publishes."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
from rosbags.interfaces import Nodetype, Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import Writer, WriterError

from logs.errors import UnwritableLogError
from logs.messages import ObjectMapRecord, TrajectoryRecord
from logs.storage.ros2_definitions import typestore
from slam.common.arrays import FloatArray
from slam.formats.trajectories import quaternions

_VERSION: Literal[8] = 8  # of the metadata: read by ROS 2 Humble and all later releases
_UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])
_NO_TIME = QosTime(0, 0)
_LATCHED = Qos(
    QosHistory.KEEP_LAST,
    1,
    QosReliability.RELIABLE,
    QosDurability.TRANSIENT_LOCAL,
    _NO_TIME,
    _NO_TIME,
    QosLiveliness.AUTOMATIC,
    _NO_TIME,
    False,
)


def write_ros2_bag(
    folder: Path, trajectory: TrajectoryRecord, objects: ObjectMapRecord, *, body_frame: str = "base_link"
) -> None:
    """Write a bag folder. All poses are those of the final map.

    * ``/slam/odometry`` nav_msgs/Odometry: the body in the map, at each stamp, and the same on
      ``/tf`` tf2_msgs/TFMessage.
    * ``/slam/path`` nav_msgs/Path, ``/slam/map`` vision_msgs/Detection3DArray: once, at the first stamp, kept for late
      subscribers. A hypothesis has the class and its probability, the pose the landmark's covariance.

    Args:
        folder: is made; it must not be there.
        trajectory: with at least one pose.
        objects: the landmarks.
        body_frame: child frame of the poses.

    Raises:
        UnwritableLogError: the folder is there, or cannot be written.
    """
    if folder.exists():
        raise UnwritableLogError(f"{folder} exists already; remove it or choose another name")
    part = folder.with_name(folder.name + ".part")
    shutil.rmtree(part, ignore_errors=True)
    try:
        part.mkdir(parents=True)
        with Writer(part / folder.name, version=_VERSION) as writer:
            connections: dict[str, Any] = {}
            for topic, type_name, stamp_ns, values in _messages(trajectory, objects, body_frame):
                if topic not in connections:
                    profiles = [] if topic in ("/tf", "/slam/odometry") else [_LATCHED]
                    connections[topic] = writer.add_connection(
                        topic, type_name, typestore=typestore(), offered_qos_profiles=profiles
                    )
                data = typestore().serialize_cdr(make_message(type_name, values), type_name)
                writer.write(connections[topic], stamp_ns, data)
        (part / folder.name).rename(folder)
        part.rmdir()
    except (WriterError, OSError) as error:
        raise UnwritableLogError(f"cannot write {folder}: {error}") from error


def _messages(
    trajectory: TrajectoryRecord, objects: ObjectMapRecord, body_frame: str
) -> Iterator[tuple[str, str, int, dict[str, Any]]]:
    """Topic, type, stamp and fields of each message, in the order of time."""
    frame, first_ns = trajectory.frame_id, int(trajectory.stamps_ns[0])
    stamped = [
        (stamp_ns, _header(stamp_ns, frame), _pose(xyz, xyzw))
        for stamp_ns, xyz, xyzw in zip(
            trajectory.stamps_ns.tolist(),
            trajectory.T_map_body[:, :3, 3],
            quaternions(trajectory.T_map_body),
            strict=True,
        )
    ]
    header = _header(first_ns, frame)
    poses = [{"header": at, "pose": pose} for _, at, pose in stamped]
    rows = range(len(objects.ids))
    yield "/slam/path", "nav_msgs/msg/Path", first_ns, {"header": header, "poses": poses}
    detections = {"header": header, "detections": [_detection(objects, row, header) for row in rows]}
    yield "/slam/map", "vision_msgs/msg/Detection3DArray", first_ns, detections
    for stamp_ns, at, pose in stamped:
        body = {"header": at, "child_frame_id": body_frame}
        yield "/slam/odometry", "nav_msgs/msg/Odometry", stamp_ns, {**body, "pose": {"pose": pose}}
        transform = {"translation": pose["position"], "rotation": pose["orientation"]}
        yield "/tf", "tf2_msgs/msg/TFMessage", stamp_ns, {"transforms": [{**body, "transform": transform}]}


def _header(stamp_ns: int, frame_id: str) -> dict[str, Any]:
    seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
    return {"stamp": {"sec": seconds, "nanosec": nanoseconds}, "frame_id": frame_id}


def _pose(xyz: FloatArray, xyzw: FloatArray = _UPRIGHT) -> dict[str, Any]:
    position, orientation = (dict(zip("xyzw", part.tolist(), strict=False)) for part in (xyz, xyzw))
    return {"position": position, "orientation": orientation}


def _detection(objects: ObjectMapRecord, row: int, header: dict[str, Any]) -> dict[str, Any]:
    pose = _pose(objects.positions[row])
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = objects.covariances[row]
    score = float(objects.class_probabilities[row].max())
    result = {
        "hypothesis": {"class_id": objects.labels[row], "score": score},
        "pose": {"pose": pose, "covariance": covariance},
    }
    return {"header": header, "results": [result], "bbox": {"center": pose}, "id": objects.ids[row]}


def make_message(type_name: str, values: Mapping[str, Any]) -> Any:
    """A message from its fields by name, those of messages within it likewise; what is left out is 0 or empty."""
    store = typestore()
    _, fields = store.fielddefs[type_name]
    return store.types[type_name](**{name: _make_field(kind, values.get(name)) for name, kind in fields})


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
