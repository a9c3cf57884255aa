"""ROS 2 messages, read by the definitions that the log itself carries."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any

from logs.decoders import ros2_clouds as clouds
from logs.decoders import ros2_detections as objects
from logs.decoders import ros2_images as images
from logs.decoders.cdr import parse
from logs.decoders.parts import covariance_6x6, fix_records, frame_records, pose_record
from logs.messages import Record
from logs.topics import RawMessage, RecordKind
from logs.validation import FloatArray, Refusal, stamp_ns, transform_from_quaternion

# What fields of other types than usual lead to; a log brings its own definitions.
_OTHER_DEFINITION = (AttributeError, TypeError, ValueError, IndexError, KeyError, OverflowError, MemoryError)


def decode(raw: RawMessage, kind: RecordKind, counters: Counter[str]) -> tuple[Record, ...]:
    """Records of one message; see :class:`logs.decoders.registry.Decoder`.

    Raises:
        Refusal: bytes that are no such message, a definition without the usual fields, or values no record may have.
    """
    schema = raw.channel.schema
    if schema is None:
        raise Refusal("no definition of the message in the log")
    message = parse(schema, raw.data)
    try:
        if schema.name in _OBJECTS:
            return _OBJECTS[schema.name](message, raw, counters)
        return _POSES[schema.name](message, kind, raw.log_time_ns, counters)
    except Refusal:
        raise
    except _OTHER_DEFINITION as error:
        raise Refusal(f"unknown version of {schema.name}", str(error)) from error


def _stamp(header: Any, log_time_ns: int) -> int:
    return stamp_ns(header.stamp.sec, header.stamp.nanosec, log_time_ns)


def _transform(position: Any, orientation: Any) -> FloatArray:
    return transform_from_quaternion(
        position.x, position.y, position.z, orientation.x, orientation.y, orientation.z, orientation.w
    )


def _odometry(message: Any, kind: RecordKind, log_time_ns: int, counters: Counter[str]) -> tuple[Record, ...]:
    T = _transform(message.pose.pose.position, message.pose.pose.orientation)
    covariance = covariance_6x6(message.pose.covariance, T, counters)
    stamp = _stamp(message.header, log_time_ns)
    return (pose_record(kind, stamp, message.header.frame_id, message.child_frame_id, T, covariance),)


def _pose_stamped(message: Any, kind: RecordKind, log_time_ns: int, counters: Counter[str]) -> tuple[Record, ...]:
    T = _transform(message.pose.position, message.pose.orientation)
    return (pose_record(kind, _stamp(message.header, log_time_ns), message.header.frame_id, "", T, None),)


def _pose_with_covariance(
    message: Any, kind: RecordKind, log_time_ns: int, counters: Counter[str]
) -> tuple[Record, ...]:
    T = _transform(message.pose.pose.position, message.pose.pose.orientation)
    covariance = covariance_6x6(message.pose.covariance, T, counters)
    return (pose_record(kind, _stamp(message.header, log_time_ns), message.header.frame_id, "", T, covariance),)


def _tf(message: Any, kind: RecordKind, log_time_ns: int, counters: Counter[str]) -> tuple[Record, ...]:
    frames = [
        (
            _stamp(t.header, log_time_ns),
            t.header.frame_id,
            t.child_frame_id,
            _transform(t.transform.translation, t.transform.rotation),
        )
        for t in message.transforms
    ]
    return frame_records(kind, frames)


def _fix(message: Any, kind: RecordKind, log_time_ns: int, counters: Counter[str]) -> tuple[Record, ...]:
    if message.status.status < 0:  # the receiver says that it has no fix
        return ()
    known = message.position_covariance if message.position_covariance_type else None
    place = (message.latitude, message.longitude, message.altitude)
    return fix_records(_stamp(message.header, log_time_ns), message.header.frame_id, place, known, counters)


_POSES: dict[str, Callable[[Any, RecordKind, int, Counter[str]], tuple[Record, ...]]] = {
    "nav_msgs/msg/Odometry": _odometry,
    "geometry_msgs/msg/PoseStamped": _pose_stamped,
    "geometry_msgs/msg/PoseWithCovarianceStamped": _pose_with_covariance,
    "tf2_msgs/msg/TFMessage": _tf,
    "sensor_msgs/msg/NavSatFix": _fix,
}
_OBJECTS: dict[str, Callable[[Any, RawMessage, Counter[str]], tuple[Record, ...]]] = {
    "vision_msgs/msg/Detection3DArray": objects.detections_3d,
    "autoware_perception_msgs/msg/DetectedObjects": objects.autoware_objects,
    "autoware_perception_msgs/msg/TrackedObjects": objects.autoware_objects,
    "autoware_auto_perception_msgs/msg/DetectedObjects": objects.autoware_objects,
    "autoware_auto_perception_msgs/msg/TrackedObjects": objects.autoware_objects,
    "visualization_msgs/msg/MarkerArray": objects.markers,
    "geometry_msgs/msg/PoseArray": objects.poses,
    "vision_msgs/msg/Detection2DArray": images.detections_2d,
    "apriltag_msgs/msg/AprilTagDetectionArray": images.tags,
    "sensor_msgs/msg/PointCloud2": clouds.labelled_scan,
    "sensor_msgs/msg/CameraInfo": images.camera_info,
    "sensor_msgs/msg/Image": images.depth_image,
}
