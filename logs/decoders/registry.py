"""Schema name and encoding -> decoder, and the kinds of records that it can give."""

from __future__ import annotations

from collections.abc import Callable

from logs.decoders import protobuf
from logs.decoders.parts import FRAMES, POSE, Context, Records
from logs.topics import Channel, RecordKind

Decoder = Callable[[Context], Records]
"""Gives the records of one message for the part that its topic plays; raises Refusal for values no record may have."""

_ROS_ENCODINGS = {"cdr": ("ros2msg", "ros2idl"), "ros1": ("ros1msg",)}
"""Encoding of messages -> encodings of their definitions."""
_AUTOWARE = ("autoware_perception_msgs", "autoware_auto_perception_msgs")
ROS_DETECTIONS = (
    "vision_msgs/msg/Detection3DArray",
    *(f"{package}/msg/{name}" for package in _AUTOWARE for name in ("TrackedObjects", "DetectedObjects")),
    "visualization_msgs/msg/MarkerArray",
    "geometry_msgs/msg/PoseArray",
    "vision_msgs/msg/Detection2DArray",
    "apriltag_msgs/msg/AprilTagDetectionArray",
    "sensor_msgs/msg/PointCloud2",
)
_ROS = {
    "nav_msgs/msg/Odometry": POSE,
    "geometry_msgs/msg/PoseStamped": POSE,
    "geometry_msgs/msg/PoseWithCovarianceStamped": POSE,
    "tf2_msgs/msg/TFMessage": FRAMES,
    "tf/msg/tfMessage": FRAMES,
    **dict.fromkeys(ROS_DETECTIONS, (RecordKind.DETECTIONS,)),
    "sensor_msgs/msg/NavSatFix": (RecordKind.GNSS,),
    "sensor_msgs/msg/CameraInfo": (RecordKind.CAMERA_INFO,),
    "sensor_msgs/msg/Image": (RecordKind.DEPTH,),
}


def kinds_of(channel: Channel) -> tuple[RecordKind, ...]:
    """What the messages of ``channel`` can be decoded to; () for a schema or an encoding that is not known."""
    if channel.message_encoding in ("protobuf", "json"):
        known = protobuf.DECODERS.get(channel.schema_name)
        return known.kinds if known is not None else ()
    if channel.schema is None or channel.schema.encoding not in _ROS_ENCODINGS.get(channel.message_encoding, ()):
        return ()
    return _ROS.get(channel.schema_name, ())


def decoder_of(channel: Channel) -> Decoder:
    """The decoder of a ``channel`` of which ``kinds_of`` knows any."""
    if channel.message_encoding in _ROS_ENCODINGS:
        from logs.decoders import ros2  # loads rosbags

        return ros2.decode
    return protobuf.decode
