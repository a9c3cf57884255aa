"""Foxglove's messages, and our own, as JSON."""

import json
from typing import Any

import numpy as np
import pytest
from google.protobuf.json_format import MessageToDict

from logs.decoders.decode import decode
from logs.encoders import encode
from logs.errors import InvalidRecordError
from logs.messages import Record
from logs.topics import Channel, RawMessage, RecordKind, Schema
from tests.logs.examples import assert_same_record, every_kind
from tests.logs.test_validation import raw


def as_json(schema: str, values: Any) -> RawMessage:
    channel = Channel("/topic", "json", Schema(schema, "jsonschema", b"{}"))
    return RawMessage(channel, 77, 77, 0, json.dumps(values).encode())


@pytest.mark.parametrize(("_", "kind", "record"), every_kind(np.random.default_rng(3)))
def test_every_message_is_the_same_as_in_protobuf(_: str, kind: RecordKind, record: Record) -> None:
    message = encode(record)
    (expected,) = decode(raw(message), kind)
    for is_proto_name in (True, False):
        values = MessageToDict(message, preserving_proto_field_name=is_proto_name)
        (found,) = decode(as_json(message.DESCRIPTOR.full_name, values), kind)
        assert_same_record(found, expected, tolerance=0.0)


@pytest.mark.parametrize("time", [{"sec": 3, "nsec": 5}, {"seconds": 3, "nanos": 5}, "1970-01-01T00:00:03.000000005Z"])
def test_times_of_foxglove_and_protobuf(time: Any) -> None:
    values = {"timestamp": time, "frame_id": "odom", "pose": {"orientation": {"w": 1}}}
    (record,) = decode(as_json("foxglove.PoseInFrame", values), "odometry")  # type: ignore[arg-type]
    assert record.stamp_ns == 3_000_000_005


def decoded(values: Any) -> tuple[Record, ...]:
    return decode(as_json("foxglove.SceneUpdate", values), "detections")  # type: ignore[arg-type]


@pytest.mark.parametrize("values", [[], 3, {"entities": 4}, {"entities": [{"cubes": [{"pose": {"position": 3}}]}]}])
def test_json_of_another_shape_is_refused(values: Any) -> None:
    with pytest.raises(InvalidRecordError, match=r"JSON does not decode \(as foxglove\.SceneUpdate"):
        decoded(values)


@pytest.mark.parametrize("data", [b"", b"{", b"\xff\xfe", b"[" * 100_000])
def test_bytes_that_are_no_json_are_refused(data: bytes) -> None:
    channel = as_json("foxglove.SceneUpdate", {}).channel
    with pytest.raises(InvalidRecordError, match="JSON does not decode"):
        decode(RawMessage(channel, 7, 7, 0, data), "detections")  # type: ignore[arg-type]
