"""Schema name and encoding -> decoder, and the kinds of records that it can give. Nothing heavy is imported here."""

from __future__ import annotations

from collections import Counter
from functools import cache
from importlib import import_module
from typing import Protocol, cast

from logs.messages import Record
from logs.topics import Channel, RawMessage, RecordKind


class Decoder(Protocol):
    """Gives the records of one message for the part that its topic plays.

    Raises:
        Refusal: values that no record may have.
    """

    def __call__(self, raw: RawMessage, kind: RecordKind, counters: Counter[str]) -> tuple[Record, ...]:
        """The records of ``raw``; ``counters`` counts what was left out of records that are otherwise good."""
        ...


_POSE = (RecordKind.ODOMETRY, RecordKind.GROUND_TRUTH)
_FRAMES = (RecordKind.TRANSFORMS, RecordKind.ODOMETRY)

ROS2_DETECTIONS = (
    "vision_msgs/msg/Detection3DArray",
    "autoware_perception_msgs/msg/DetectedObjects",
    "autoware_perception_msgs/msg/TrackedObjects",
    "autoware_auto_perception_msgs/msg/DetectedObjects",
    "autoware_auto_perception_msgs/msg/TrackedObjects",
    "visualization_msgs/msg/MarkerArray",
    "geometry_msgs/msg/PoseArray",
    "vision_msgs/msg/Detection2DArray",
    "apriltag_msgs/msg/AprilTagDetectionArray",
    "sensor_msgs/msg/PointCloud2",
)
_DEFINITIONS = {"cdr": ("ros2msg", "ros2idl"), "ros1": ("ros1msg",)}

_MESSAGES: dict[str, tuple[RecordKind, ...]] = {
    "foxglove.Odometry": _POSE,
    "foxglove.PoseInFrame": (*_POSE, RecordKind.SLAM_POSE),
    "foxglove.FrameTransform": _FRAMES,
    "foxglove.FrameTransforms": _FRAMES,
    "foxglove.SceneUpdate": (RecordKind.DETECTIONS,),
    "foxglove.LocationFix": (RecordKind.GNSS,),
    "dslam.ObjectDetections": (RecordKind.DETECTIONS,),
    "dslam.DetectionTruth": (RecordKind.DETECTION_TRUTH,),
    "dslam.DetectionAssociations": (RecordKind.ASSOCIATIONS,),
    "dslam.ObjectMap": (RecordKind.OBJECT_MAP, RecordKind.OBJECT_TRUTH),
    "dslam.Trajectory": (RecordKind.TRAJECTORY,),
    "dslam.FactorGraph": (RecordKind.FACTOR_GRAPH,),
    "dslam.LoopClosure": (RecordKind.LOOP_CLOSURES,),
    "dslam.Relocalization": (RecordKind.RELOCALIZATIONS,),
    "dslam.Status": (RecordKind.STATUS,),
    "dslam.Localization": (RecordKind.LOCALIZATION,),
}
_ROS2 = {
    "nav_msgs/msg/Odometry": _POSE,
    "geometry_msgs/msg/PoseStamped": _POSE,
    "geometry_msgs/msg/PoseWithCovarianceStamped": _POSE,
    "tf2_msgs/msg/TFMessage": _FRAMES,
    "tf/msg/tfMessage": _FRAMES,
    **dict.fromkeys(ROS2_DETECTIONS, (RecordKind.DETECTIONS,)),
    "sensor_msgs/msg/NavSatFix": (RecordKind.GNSS,),
    "sensor_msgs/msg/CameraInfo": (RecordKind.CAMERA_INFO,),
    "sensor_msgs/msg/Image": (RecordKind.DEPTH,),
}
_ENCODINGS = {
    **dict.fromkeys(("protobuf", "json"), ("protobuf", _MESSAGES)),
    **dict.fromkeys(("cdr", "ros1"), ("ros2", _ROS2)),
}
"""Encoding -> the module that decodes it, and the kinds by schema."""


def kinds_of(channel: Channel) -> tuple[RecordKind, ...]:
    """What the messages of ``channel`` can be decoded to; () for a schema or an encoding that is not known."""
    needed = _DEFINITIONS.get(channel.message_encoding)
    if needed is not None and (channel.schema is None or channel.schema.encoding not in needed):
        return ()
    return _ENCODINGS.get(channel.message_encoding, ("", {}))[1].get(channel.schema_name, ())


def decoder_for(channel: Channel) -> Decoder:
    """The decoder of a ``channel`` of which ``kinds_of`` knows any."""
    return _load_decoder(channel.message_encoding)


@cache
def _load_decoder(encoding: str) -> Decoder:
    return cast(Decoder, import_module(f".{_ENCODINGS[encoding][0]}", __package__).decode)
