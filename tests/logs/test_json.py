"""Foxglove's messages, and our own, as JSON."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from google.protobuf.json_format import MessageToDict

from logs.decoders.decode import decode
from logs.decoders.protobuf import DECODERS
from logs.errors import InvalidRecordError
from logs.messages import Record
from logs.reader import LogReader
from logs.topics import Channel, RawMessage, Schema
from logs.writer import LogWriter
from tests.logs.examples import assert_same_record, every_kind

EVERY = every_kind(np.random.default_rng(3))


def as_json(schema: str, values: Any, log_time_ns: int = 7) -> RawMessage:
    channel = Channel(1, "/topic", "json", Schema(1, schema, "jsonschema", b"{}"))
    return RawMessage(channel, log_time_ns, log_time_ns, 0, json.dumps(values).encode())


@pytest.mark.parametrize("index", range(len(EVERY)), ids=[type(record).__name__ for _, _, record in EVERY])
def test_every_message_is_the_same_as_in_protobuf(tmp_path: Path, index: int) -> None:
    topic, kind, record = EVERY[index]
    with LogWriter(tmp_path / "log.mcap") as writer:
        writer.write(topic, record)
    with LogReader(tmp_path / "log.mcap") as reader:
        (raw,) = reader.messages()
    message = DECODERS[raw.channel.schema_name].message_class.FromString(raw.data)
    (expected,) = decode(raw, kind)
    for is_proto_name in (True, False):
        values = MessageToDict(message, preserving_proto_field_name=is_proto_name)
        (found,) = decode(as_json(raw.channel.schema_name, values, raw.log_time_ns), kind)
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
    raw = as_json("foxglove.SceneUpdate", {})
    with pytest.raises(InvalidRecordError, match="JSON does not decode"):
        decode(RawMessage(raw.channel, 7, 7, 0, data), "detections")  # type: ignore[arg-type]
