"""A mapped drive as a ROS 2 bag (rosbag2, SQLite, CDR), in messages of ROS that `ros2 bag play` publishes."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import numpy as np
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import Writer, WriterError

from logs.errors import UnwritableLogError
from logs.messages import ObjectMapRecord, TrajectoryRecord
from logs.scene import class_color
from logs.storage.ros2_definitions import typestore
from slam.common.arrays import FloatArray
from slam.formats.g2o import quaternions

_VERSION: Literal[8] = 8  # of the metadata: read by ROS 2 Humble and all later releases
_CUBE, _ADD = 1, 0
_MARKER_SIZE_M = 0.6
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
    * ``/slam/path`` nav_msgs/Path, ``/slam/landmarks`` visualization_msgs/MarkerArray, ``/slam/map``
      vision_msgs/Detection3DArray: once, at the first stamp, kept for late subscribers. A hypothesis has the class and
      its probability, the pose the landmark's covariance.

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
            for topic, type_name, stamp_ns, message in _Messages(trajectory, objects, body_frame):
                if topic not in connections:
                    profiles = [] if topic in ("/tf", "/slam/odometry") else [_LATCHED]
                    connections[topic] = writer.add_connection(
                        topic, type_name, typestore=typestore(), offered_qos_profiles=profiles
                    )
                writer.write(connections[topic], stamp_ns, typestore().serialize_cdr(message, type_name))
        (part / folder.name).rename(folder)
        part.rmdir()
    except (WriterError, OSError) as error:
        raise UnwritableLogError(f"cannot write {folder}: {error}") from error


class _Messages:
    """Topic, type, stamp and message, in the order of time."""

    def __init__(self, trajectory: TrajectoryRecord, objects: ObjectMapRecord, body_frame: str) -> None:
        self._types = typestore().types
        self._trajectory = trajectory
        self._objects = objects
        self._body_frame = body_frame

    def __iter__(self) -> Iterator[tuple[str, str, int, Any]]:
        stamps_ns = self._trajectory.stamps_ns.tolist()
        poses = [
            self._pose(xyz, xyzw)
            for xyz, xyzw in zip(
                self._trajectory.T_map_body[:, :3, 3], quaternions(self._trajectory.T_map_body), strict=True
            )
        ]
        yield "/slam/path", "nav_msgs/msg/Path", stamps_ns[0], self._path(stamps_ns, poses)
        yield "/slam/landmarks", "visualization_msgs/msg/MarkerArray", stamps_ns[0], self._markers(stamps_ns[0])
        yield "/slam/map", "vision_msgs/msg/Detection3DArray", stamps_ns[0], self._detections(stamps_ns[0])
        for stamp_ns, pose in zip(stamps_ns, poses, strict=True):
            yield "/slam/odometry", "nav_msgs/msg/Odometry", stamp_ns, self._odometry(stamp_ns, pose)
            yield "/tf", "tf2_msgs/msg/TFMessage", stamp_ns, self._transform(stamp_ns, pose)

    def _make(self, type_name: str, **fields: Any) -> Any:
        return self._types[type_name](**fields)

    def _header(self, stamp_ns: int) -> Any:
        seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
        stamp = self._make("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)
        return self._make("std_msgs/msg/Header", stamp=stamp, frame_id=self._trajectory.frame_id)

    def _vector(self, x: float, y: float, z: float) -> Any:
        return self._make("geometry_msgs/msg/Vector3", x=x, y=y, z=z)

    def _pose(self, xyz: FloatArray, xyzw: FloatArray) -> Any:
        x, y, z = xyz.tolist()
        qx, qy, qz, qw = xyzw.tolist()
        return self._make(
            "geometry_msgs/msg/Pose",
            position=self._make("geometry_msgs/msg/Point", x=x, y=y, z=z),
            orientation=self._make("geometry_msgs/msg/Quaternion", x=qx, y=qy, z=qz, w=qw),
        )

    def _upright(self, xyz: FloatArray) -> Any:
        return self._pose(xyz, np.array([0.0, 0.0, 0.0, 1.0]))

    def _path(self, stamps_ns: list[int], poses: list[Any]) -> Any:
        stamped = [
            self._make("geometry_msgs/msg/PoseStamped", header=self._header(stamp_ns), pose=pose)
            for stamp_ns, pose in zip(stamps_ns, poses, strict=True)
        ]
        return self._make("nav_msgs/msg/Path", header=self._header(stamps_ns[0]), poses=stamped)

    def _odometry(self, stamp_ns: int, pose: Any) -> Any:
        nothing = np.zeros(36)
        still = self._make(
            "geometry_msgs/msg/Twist", linear=self._vector(0.0, 0.0, 0.0), angular=self._vector(0.0, 0.0, 0.0)
        )
        return self._make(
            "nav_msgs/msg/Odometry",
            header=self._header(stamp_ns),
            child_frame_id=self._body_frame,
            pose=self._make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=nothing),
            twist=self._make("geometry_msgs/msg/TwistWithCovariance", twist=still, covariance=nothing),
        )

    def _transform(self, stamp_ns: int, pose: Any) -> Any:
        p = pose.position
        transform = self._make(
            "geometry_msgs/msg/Transform", translation=self._vector(p.x, p.y, p.z), rotation=pose.orientation
        )
        stamped = self._make(
            "geometry_msgs/msg/TransformStamped",
            header=self._header(stamp_ns),
            child_frame_id=self._body_frame,
            transform=transform,
        )
        return self._make("tf2_msgs/msg/TFMessage", transforms=[stamped])

    def _markers(self, stamp_ns: int) -> Any:
        nothing = self._make("builtin_interfaces/msg/Duration", sec=0, nanosec=0)
        markers = []
        for row, label in enumerate(self._objects.labels):
            red, green, blue, alpha = class_color(label)
            markers.append(
                self._make(
                    "visualization_msgs/msg/Marker",
                    header=self._header(stamp_ns),
                    ns=label,
                    id=row,
                    type=_CUBE,
                    action=_ADD,
                    pose=self._upright(self._objects.positions[row]),
                    scale=self._vector(_MARKER_SIZE_M, _MARKER_SIZE_M, _MARKER_SIZE_M),
                    color=self._make("std_msgs/msg/ColorRGBA", r=red, g=green, b=blue, a=alpha),
                    lifetime=nothing,
                    frame_locked=False,
                    points=[],
                    colors=[],
                    texture_resource="",
                    texture=self._no_texture(stamp_ns),
                    uv_coordinates=[],
                    text=label,
                    mesh_resource="",
                    mesh_file=self._make("visualization_msgs/msg/MeshFile", filename="", data=np.zeros(0, np.uint8)),
                    mesh_use_embedded_materials=False,
                )
            )
        return self._make("visualization_msgs/msg/MarkerArray", markers=markers)

    def _no_texture(self, stamp_ns: int) -> Any:
        return self._make(
            "sensor_msgs/msg/CompressedImage", header=self._header(stamp_ns), format="", data=np.zeros(0, np.uint8)
        )

    def _detections(self, stamp_ns: int) -> Any:
        detections = []
        for row, label in enumerate(self._objects.labels):
            pose = self._upright(self._objects.positions[row])
            covariance = np.zeros((6, 6))
            covariance[:3, :3] = self._objects.covariances[row]
            hypothesis = self._make(
                "vision_msgs/msg/ObjectHypothesis",
                class_id=label,
                score=float(self._objects.class_probabilities[row].max()),
            )
            result = self._make(
                "vision_msgs/msg/ObjectHypothesisWithPose",
                hypothesis=hypothesis,
                pose=self._make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=covariance.ravel()),
            )
            detections.append(
                self._make(
                    "vision_msgs/msg/Detection3D",
                    header=self._header(stamp_ns),
                    results=[result],
                    bbox=self._make("vision_msgs/msg/BoundingBox3D", center=pose, size=self._vector(0.0, 0.0, 0.0)),
                    id=self._objects.ids[row],
                )
            )
        return self._make("vision_msgs/msg/Detection3DArray", header=self._header(stamp_ns), detections=detections)
