"""``dslam.*`` and ``foxglove.*`` messages, through their generated modules.

Objects in a foxglove.SceneUpdate: each cube, sphere, cylinder and model of an entity is one detection; an entity with
none of these, but with a text, is one at the place of the text. Its class is the entity's metadata "label", else
"class", else its first text, else its id up to a trailing number ("tree/12" is a "tree"). Its score is the metadata
"score", else 1; its track id is the entity's id. Entities of other frames or times become records of their own.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable
from typing import Any

from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry as FoxgloveOdometry
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.message import DecodeError

from logs.decoders.dslam import DSLAM_DECODERS
from logs.decoders.parts import DetectionGroups, covariance_6x6, fix_records, frame_records, pose_record
from logs.messages import Record
from logs.topics import RawMessage, RecordKind
from logs.validation import FloatArray, Refusal, stamp_ns, transform_from_quaternion

_TRAILING_NUMBER = re.compile(r"[/:_\-# ]*\d*$")


def decode(raw: RawMessage, kind: RecordKind, counters: Counter[str]) -> tuple[Record, ...]:
    """Records of one message; see :class:`logs.decoders.registry.Decoder`.

    Raises:
        Refusal: bytes that are no such message, or values that no record may have.
    """
    return decode_parsed(_parse, raw, kind, counters)


def decode_parsed(
    parse: Callable[[Any, RawMessage], Any], raw: RawMessage, kind: RecordKind, counters: Counter[str]
) -> tuple[Record, ...]:
    """Records of the message that ``parse`` makes of the message class of the schema, and of ``raw``.

    Raises:
        Refusal: values that no record may have.
    """
    message_class, function = DECODERS[raw.channel.schema_name]
    return function(parse(message_class, raw), kind, raw.log_time_ns, counters)


def _parse(message_class: Any, raw: RawMessage) -> Any:
    try:
        return message_class.FromString(raw.data)
    except DecodeError as error:
        raise Refusal("bytes do not decode", f"{len(raw.data)} bytes as {raw.channel.schema_name}") from error


def _stamp(message: Any, log_time_ns: int) -> int:
    return stamp_ns(message.timestamp.seconds, message.timestamp.nanos, log_time_ns)


def _transform(position: Any, orientation: Any) -> FloatArray:
    return transform_from_quaternion(
        position.x, position.y, position.z, orientation.x, orientation.y, orientation.z, orientation.w
    )


def _odometry(message: Any, kind: RecordKind, log_time_ns: int, counters: Counter[str]) -> tuple[Record, ...]:
    T = _transform(message.pose.position, message.pose.orientation)
    covariance = covariance_6x6(message.pose_covariance, T, counters)
    stamp = _stamp(message, log_time_ns)
    return (pose_record(kind, stamp, message.frame_id, message.body_frame_id, T, covariance),)


def _pose_in_frame(message: Any, kind: RecordKind, log_time_ns: int, counters: Counter[str]) -> tuple[Record, ...]:
    T = _transform(message.pose.position, message.pose.orientation)
    return (pose_record(kind, _stamp(message, log_time_ns), message.frame_id, "", T, None),)


def _location_fix(message: Any, kind: RecordKind, log_time_ns: int, counters: Counter[str]) -> tuple[Record, ...]:
    known = message.position_covariance if message.position_covariance_type else None
    if known is not None and len(known) != 9:
        raise Refusal("lengths disagree", f"covariance of {len(known)} numbers, not 9")
    place = (message.latitude, message.longitude, message.altitude)
    return fix_records(_stamp(message, log_time_ns), message.frame_id, place, known, counters)


def _frame_transforms(message: Any, kind: RecordKind, log_time_ns: int, counters: Counter[str]) -> tuple[Record, ...]:
    frames = [
        (_stamp(t, log_time_ns), t.parent_frame_id, t.child_frame_id, _transform(t.translation, t.rotation))
        for t in (message.transforms if isinstance(message, FrameTransforms) else [message])
    ]
    return frame_records(kind, frames)


def _scene_update(message: Any, kind: RecordKind, log_time_ns: int, counters: Counter[str]) -> tuple[Record, ...]:
    groups = DetectionGroups()
    for entity in message.entities:
        objects = [(p.pose.position, p.size) for p in (*entity.cubes, *entity.spheres, *entity.cylinders)]
        objects += [(p.pose.position, None) for p in entity.models]
        if not objects:
            objects = [(t.pose.position, None) for t in entity.texts[:1]]
        if not objects:
            continue
        detections = groups.of(_stamp(entity, log_time_ns), entity.frame_id)
        label, score = _class_and_score(entity)
        for position, size in objects:
            detections.add(
                (position.x, position.y, position.z),
                label,
                score,
                size=None if size is None else (size.x, size.y, size.z),
                track_id=entity.id,
            )
    return groups.records(counters)


def _class_and_score(entity: Any) -> tuple[str, float]:
    metadata = {pair.key: pair.value for pair in entity.metadata}
    label = metadata.get("label") or metadata.get("class")
    if not label:
        label = entity.texts[0].text if entity.texts else _TRAILING_NUMBER.sub("", entity.id)
    try:
        return label, float(metadata.get("score", "1"))
    except ValueError:
        return label, 1.0


_Function = Callable[[Any, RecordKind, int, Counter[str]], tuple[Record, ...]]
DECODERS: dict[str, tuple[Any, _Function]] = {
    "foxglove.Odometry": (FoxgloveOdometry, _odometry),
    "foxglove.PoseInFrame": (PoseInFrame, _pose_in_frame),
    "foxglove.FrameTransform": (FrameTransform, _frame_transforms),
    "foxglove.FrameTransforms": (FrameTransforms, _frame_transforms),
    "foxglove.LocationFix": (LocationFix, _location_fix),
    "foxglove.SceneUpdate": (SceneUpdate, _scene_update),
    **DSLAM_DECODERS,
}
