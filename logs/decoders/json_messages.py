"""``foxglove.*`` and ``dslam.*`` messages as JSON, read into the same messages as their protobuf form.

Fields have the names of the schema or those of protobuf's JSON. A time is ``{"sec": 1, "nsec": 2}``, as Foxglove writes
it, or text as in RFC 3339; bytes are base64.
"""

from __future__ import annotations

import json
from base64 import b64decode
from collections import Counter
from typing import Any

from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.message import Message

from logs.decoders.protobuf import decode_parsed
from logs.messages import Record
from logs.topics import RawMessage, RecordKind
from logs.validation import Refusal

_TIMES = ("google.protobuf.Timestamp", "google.protobuf.Duration")
_FLOATS = (FieldDescriptor.CPPTYPE_DOUBLE, FieldDescriptor.CPPTYPE_FLOAT)
_UNFIT = (ValueError, TypeError, AttributeError, KeyError, OverflowError, RecursionError)


def decode(raw: RawMessage, kind: RecordKind, counters: Counter[str]) -> tuple[Record, ...]:
    """Records of one message; see :class:`logs.decoders.registry.Decoder`.

    Raises:
        Refusal: bytes that are no such message, or values that no record may have.
    """
    return decode_parsed(_parse, raw, kind, counters)


def _parse(message_class: Any, raw: RawMessage) -> Any:
    try:
        message = message_class()
        _fill(message, json.loads(raw.data))
    except _UNFIT as error:
        what = f"as {raw.channel.schema_name}: {' '.join(str(error).split())[:200]}"
        raise Refusal("JSON does not decode", what) from error
    return message


def _fill(message: Message, values: Any) -> None:
    if message.DESCRIPTOR.full_name in _TIMES:
        _fill_time(message, values)
        return
    if not isinstance(values, dict):
        raise ValueError(f"{message.DESCRIPTOR.name} is no object")
    for field in message.DESCRIPTOR.fields:
        value = values.get(field.name, values.get(field.json_name))
        if value is None:
            continue
        if field.message_type is not None and field.message_type.GetOptions().map_entry:
            held = field.message_type.fields_by_name["value"]
            getattr(message, field.name).update({key: _scalar(held, item) for key, item in value.items()})
        elif field.is_repeated and field.message_type is not None:
            for item in value:
                _fill(getattr(message, field.name).add(), item)
        elif field.is_repeated:
            getattr(message, field.name).extend([_scalar(field, item) for item in value])
        elif field.message_type is not None:
            getattr(message, field.name).SetInParent()
            _fill(getattr(message, field.name), value)
        else:
            setattr(message, field.name, _scalar(field, value))


def _fill_time(message: Any, value: Any) -> None:
    if isinstance(value, str):
        message.FromJsonString(value)
    else:
        message.seconds = int(value.get("sec", value.get("seconds", 0)))
        message.nanos = int(value.get("nsec", value.get("nanosec", value.get("nanos", 0))))


def _scalar(field: Any, value: Any) -> Any:
    if field.cpp_type in _FLOATS:
        return float(value)
    if field.enum_type is not None:
        return field.enum_type.values_by_name[value].number if isinstance(value, str) else int(value)
    if field.type == FieldDescriptor.TYPE_BYTES:
        return b64decode(value)
    if field.cpp_type == FieldDescriptor.CPPTYPE_BOOL or field.type == FieldDescriptor.TYPE_STRING:
        return value
    return int(value)
