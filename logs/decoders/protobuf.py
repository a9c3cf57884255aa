"""``dslam.*`` and ``foxglove.*`` messages in protobuf and in JSON.

Objects in a foxglove.SceneUpdate: each cube, sphere, cylinder and model of an entity is one detection; an entity with
none of these, but with a text, is one at the place of the text. Its class is the entity's metadata "label", else
"class", else its first text, else its id up to a trailing number ("tree/12" is a "tree"). Its score is the metadata
"score", else 1. Entities of other frames or times become records of their own.

In JSON, fields have the names of the schema or those of protobuf's JSON. A time is ``{"sec": 1, "nsec": 2}``, as
Foxglove writes it, or text as in RFC 3339; bytes are base64.
"""

import json
import re
from collections import defaultdict
from typing import Any

from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.json_format import ParseDict, ParseError
from google.protobuf.message import DecodeError
from google.protobuf.timestamp_pb2 import Timestamp

from logs import messages as m
from logs.decoders.parts import (
    DETECTIONS,
    FRAMES,
    POSE,
    Context,
    Detection,
    MessageDecoder,
    Place,
    Records,
    detection_records,
    fix_records,
    frame_records,
    place_of,
    pose_decoder,
    usable_detections,
    xyz,
)
from logs.dslam_codec import CODECS, Codec, check_arrays
from logs.topics import RawMessage, RecordKind
from logs.validation import Refusal

_TRAILING_NUMBER = re.compile(r"[/:_\-# ]*\d*$")
_NO_JSON = (ParseError, ValueError, TypeError, AttributeError, KeyError, OverflowError, RecursionError)


def parse(raw: RawMessage, message_class: Any) -> Any:
    """The message in ``raw``.

    Raises:
        Refusal: bytes that are no such message.
    """
    try:
        if raw.channel.message_encoding != "json":
            return message_class.FromString(raw.data)
        values = json.loads(raw.data, object_hook=_with_text_for_time, parse_constant=str)
        if not isinstance(values, dict):
            raise ValueError("no object")
        return ParseDict(values, message_class(), ignore_unknown_fields=True)
    except DecodeError as error:
        raise Refusal("bytes do not decode", f"{len(raw.data)} bytes as {raw.channel.schema_name}") from error
    except _NO_JSON as error:
        what = f"as {raw.channel.schema_name}: {' '.join(str(error).split())[:200]}"
        raise Refusal("JSON does not decode", what) from error


def _with_text_for_time(values: dict[str, Any]) -> Any:
    """A time in numbers as protobuf's JSON writes it; other values as they are."""
    unit_ns = {"sec": 10**9, "seconds": 10**9, "nsec": 1, "nanosec": 1, "nanos": 1}
    if not values or not values.keys() <= unit_ns.keys():
        return values
    found = Timestamp()
    found.FromNanoseconds(sum(int(value) * unit_ns[name] for name, value in values.items()))
    return found.ToJsonString()


def _scene_update(message: Any, context: Context) -> Records:
    scans: dict[Place, list[Detection]] = defaultdict(list)
    for entity in message.entities:
        objects: list[Any] = [*entity.cubes, *entity.spheres, *entity.cylinders, *entity.models]
        if objects := objects or [*entity.texts[:1]]:
            label, score = _class_and_score(entity)
            scans[place_of(entity, context)] += [Detection(xyz(p.pose.position), label, score) for p in objects]
    return detection_records(scans, context.counters)


def _class_and_score(entity: Any) -> tuple[str, float]:
    metadata = {pair.key: pair.value for pair in entity.metadata}
    named = entity.texts[0].text if entity.texts else _TRAILING_NUMBER.sub("", entity.id)
    label = metadata.get("label") or metadata.get("class") or named
    try:
        return label, float(metadata.get("score", "1"))
    except ValueError:
        return label, 1.0


def _own(codec: Codec) -> MessageDecoder:
    def decode(message: Any, context: Context) -> Records:
        found = codec.decode(message, context.counters)
        if isinstance(found, m.ObjectDetections):
            return (usable_detections(found, context.counters),)
        check_arrays(found)
        return (found,)

    return MessageDecoder(codec.kinds, decode, codec.message_class)


DECODERS: dict[str, MessageDecoder] = {
    decoder.message_class.DESCRIPTOR.full_name: decoder
    for decoder in (
        MessageDecoder(POSE, pose_decoder("pose", "body_frame_id"), Odometry),
        MessageDecoder((*POSE, RecordKind.SLAM_POSE), pose_decoder("pose"), PoseInFrame),
        MessageDecoder(FRAMES, frame_records, FrameTransform),
        MessageDecoder(FRAMES, frame_records, FrameTransforms),
        MessageDecoder((RecordKind.GNSS,), fix_records, LocationFix),
        MessageDecoder(DETECTIONS, _scene_update, SceneUpdate),
        *map(_own, CODECS.values()),
    )
}
"""Schema -> what decodes its messages."""
