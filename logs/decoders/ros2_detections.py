"""Objects in ROS 2 messages, in three dimensions. Each object is at the stamp and in the frame of its own header; where
that is empty, of the array's.

* vision_msgs/msg/Detection3DArray: the class and the score are those of the result with the highest score, the position
  is the centre of the box, or, where the box was left empty, the pose of that result; the covariance is that of the
  result's pose.
* autoware (auto_)perception_msgs DetectedObjects, TrackedObjects: the class is the most probable one, by the name that
  the log's own definition gives its number.
* visualization_msgs/msg/MarkerArray: cubes, spheres, cylinders, meshes and lists of them that are added, not deleted; a
  class is the marker's text, else its namespace. Texts are objects only where there is nothing else.
* geometry_msgs/msg/PoseArray: the class is the name of the topic ("/map/poles": "poles").
"""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from logs.decoders.cdr import constants_of
from logs.decoders.parts import DetectionGroups
from logs.messages import Record
from logs.topics import RawMessage, Schema
from logs.validation import FloatArray, stamp_ns, transform_from_quaternion

_CUBE, _SPHERE, _CYLINDER, _CUBE_LIST, _SPHERE_LIST, _TEXT, _MESH = 1, 2, 3, 6, 7, 9, 10
_ADD = 0


def detections_3d(message: Any, raw: RawMessage, counters: Counter[str]) -> tuple[Record, ...]:
    """Records of a Detection3DArray."""
    groups = DetectionGroups()
    own = place_of(message.header, raw.log_time_ns)
    groups.of(*own)
    for detection in message.detections:
        best = max(detection.results, key=lambda result: hypothesis_of(result)[1], default=None)
        label, score = ("", 1.0) if best is None else hypothesis_of(best)
        center, size = detection.bbox.center.position, detection.bbox.size
        position = (center.x, center.y, center.z)
        has_box = any(position) or any((size.x, size.y, size.z))
        if best is not None and not has_box:
            center = best.pose.pose.position
            position = (center.x, center.y, center.z)
        groups.of(*place_of(detection.header, raw.log_time_ns, own)).add(
            position,
            label,
            score,
            covariance=None if best is None else position_covariance(best.pose.covariance),
            size=(size.x, size.y, size.z) if has_box else None,
            track_id=getattr(detection, "id", ""),
        )
    return groups.records(counters)


def autoware_objects(message: Any, raw: RawMessage, counters: Counter[str]) -> tuple[Record, ...]:
    """Records of DetectedObjects or TrackedObjects."""
    groups = DetectionGroups()
    detections = groups.of(*place_of(message.header, raw.log_time_ns))
    names = _class_names(raw.channel.schema)
    for seen in message.objects:
        best = max(seen.classification, key=lambda c: c.probability, default=None)
        placed = seen.kinematics.pose_with_covariance
        center, size = placed.pose.position, seen.shape.dimensions
        is_known = getattr(seen.kinematics, "has_position_covariance", True)
        identity = getattr(seen, "object_id", None)
        detections.add(
            (center.x, center.y, center.z),
            "" if best is None else names.get(best.label, f"class {best.label}"),
            seen.existence_probability,
            covariance=position_covariance(placed.covariance) if is_known else None,
            size=(size.x, size.y, size.z),
            track_id="" if identity is None else bytes(identity.uuid).hex(),
        )
    return groups.records(counters)


def _class_names(schema: Schema | None) -> dict[int, str]:
    """Number -> name in small letters, from the constants of ObjectClassification."""
    if schema is None:
        return {}
    package = schema.name.partition("/")[0]
    constants = constants_of(schema, f"{package}/msg/ObjectClassification")
    return {int(number): name.lower() for name, number in constants.items()}


def markers(message: Any, raw: RawMessage, counters: Counter[str]) -> tuple[Record, ...]:
    """Records of a MarkerArray."""
    groups = DetectionGroups()
    added = [marker for marker in message.markers if marker.action == _ADD]
    shapes = (_CUBE, _SPHERE, _CYLINDER, _MESH, _CUBE_LIST, _SPHERE_LIST)
    objects = [marker for marker in added if marker.type in shapes] or [m for m in added if m.type == _TEXT]
    for marker in objects:
        detections = groups.of(*place_of(marker.header, raw.log_time_ns))
        size = None if marker.type == _TEXT else (marker.scale.x, marker.scale.y, marker.scale.z)
        track_id = f"{marker.ns}/{marker.id}"
        if marker.type in (_CUBE_LIST, _SPHERE_LIST):
            points = _turn(marker.pose, np.array([(p.x, p.y, p.z) for p in marker.points]).reshape(-1, 3))
            tracks = [f"{track_id}/{i}" for i in range(len(points))]
        else:
            p = marker.pose.position
            points, tracks = np.array([[p.x, p.y, p.z]]), [track_id]
        for (x, y, z), track in zip(points.tolist(), tracks, strict=True):
            detections.add((x, y, z), marker.text or marker.ns, 1.0, size=size, track_id=track)
    return groups.records(counters)


def poses(message: Any, raw: RawMessage, counters: Counter[str]) -> tuple[Record, ...]:
    """Records of a PoseArray."""
    groups = DetectionGroups()
    detections = groups.of(*place_of(message.header, raw.log_time_ns))
    label = raw.topic.rstrip("/").rpartition("/")[2]
    for pose in message.poses:
        detections.add((pose.position.x, pose.position.y, pose.position.z), label, 1.0)
    return groups.records(counters)


def hypothesis_of(result: Any) -> tuple[str, float]:
    """Class and score of a result; the first versions of vision_msgs have them in the result itself."""
    hypothesis = getattr(result, "hypothesis", result)
    label = getattr(hypothesis, "class_id", None)
    return (hypothesis.id if label is None else label), hypothesis.score


def position_covariance(values: Any) -> FloatArray | None:
    """``(3, 3)`` m^2 of the 36 numbers of ROS; None where they are zero.

    A coordinate whose row is zero while others are not was not estimated: it gets the largest variance of the others.
    """
    P = np.array(values, dtype=np.float64).reshape(6, 6)[:3, :3]
    empty = ~(P.any(axis=0) | P.any(axis=1))
    if empty.all():
        return None
    P[empty, empty] = np.diagonal(P).max()
    return P


def _turn(pose: Any, points: FloatArray) -> FloatArray:
    p, q = pose.position, pose.orientation
    is_set = any((q.x, q.y, q.z, q.w))  # many leave it at zero, which viewers take for none
    T = transform_from_quaternion(p.x, p.y, p.z, q.x, q.y, q.z, q.w if is_set else 1.0)
    return points @ T[:3, :3].T + T[:3, 3]


def place_of(header: Any, log_time_ns: int, otherwise: tuple[int, str] | None = None) -> tuple[int, str]:
    """Stamp and frame of ``header``; those of ``otherwise`` where they are empty."""
    stamp = stamp_ns(header.stamp.sec, header.stamp.nanosec, log_time_ns if otherwise is None else otherwise[0])
    return stamp, header.frame_id or (otherwise[1] if otherwise else "")
