"""ROS 2 messages (CDR with a ``ros2msg`` or ``ros2idl`` schema), read by the definitions that the log itself carries.

Objects in a vision_msgs/msg/Detection3DArray: the class and the score are those of the result with the highest score,
the position is the centre of the box, or, where the box was left empty, the pose of that result; the covariance is that
of the result's pose.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np

from logs.decoders.cdr import parse
from logs.decoders.parts import DetectionList, covariance_6x6, frame_records, pose_record
from logs.messages import Record
from logs.topics import RawMessage, RecordKind
from logs.validation import FloatArray, Refusal, stamp_ns, transform_from_quaternion


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
        return _DECODERS[schema.name](message, kind, raw.log_time_ns, counters)
    except AttributeError as error:
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


def _detections(message: Any, kind: RecordKind, log_time_ns: int, counters: Counter[str]) -> tuple[Record, ...]:
    detections = DetectionList(_stamp(message.header, log_time_ns), message.header.frame_id)
    for detection in message.detections:
        best = max(detection.results, key=lambda result: result.hypothesis.score, default=None)
        center, size = detection.bbox.center.position, detection.bbox.size
        position = (center.x, center.y, center.z)
        has_box = any(position) or any((size.x, size.y, size.z))
        covariance = None
        if best is not None:
            covariance = np.array(best.pose.covariance, dtype=np.float64).reshape(6, 6)[:3, :3]
            if not has_box:
                center = best.pose.pose.position
                position = (center.x, center.y, center.z)
        detections.add(
            position,
            best.hypothesis.class_id if best is not None else "",
            best.hypothesis.score if best is not None else 1.0,
            covariance=covariance if covariance is not None and covariance.any() else None,
            size=(size.x, size.y, size.z) if has_box else None,
            track_id=detection.id,
        )
    return (detections.record(counters),)


_DECODERS: dict[str, Callable[[Any, RecordKind, int, Counter[str]], tuple[Record, ...]]] = {
    "nav_msgs/msg/Odometry": _odometry,
    "geometry_msgs/msg/PoseStamped": _pose_stamped,
    "geometry_msgs/msg/PoseWithCovarianceStamped": _pose_with_covariance,
    "tf2_msgs/msg/TFMessage": _tf,
    "vision_msgs/msg/Detection3DArray": _detections,
}
