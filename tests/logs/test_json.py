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


def foxglove_times(values: Any) -> Any:
    """Times as Foxglove writes them in JSON."""
    if isinstance(values, dict):
        times = {
            key: {
                "sec": int(np.datetime64(value.rstrip("Z"), "ns").astype(np.int64)) // 10**9,
                "nsec": int(np.datetime64(value.rstrip("Z"), "ns").astype(np.int64)) % 10**9,
            }
            for key, value in values.items()
            if key == "timestamp"
        }
        return {key: times.get(key, foxglove_times(value)) for key, value in values.items()}
    return [foxglove_times(value) for value in values] if isinstance(values, list) else values


@pytest.mark.parametrize("index", range(len(EVERY)), ids=[type(record).__name__ for _, _, record in EVERY])
@pytest.mark.parametrize("style", ["foxglove", "protobuf"])
def test_every_message_is_the_same_as_in_protobuf(tmp_path: Path, index: int, style: str) -> None:
    topic, kind, record = EVERY[index]
    with LogWriter(tmp_path / "log.mcap") as writer:
        writer.write(topic, record)
    with LogReader(tmp_path / "log.mcap") as reader:
        (raw,) = reader.messages()
    message = DECODERS[raw.channel.schema_name].message_class.FromString(raw.data)
    values = MessageToDict(message, preserving_proto_field_name=style == "foxglove")
    values = foxglove_times(values) if style == "foxglove" else values
    (expected,) = decode(raw, kind)
    (found,) = decode(as_json(raw.channel.schema_name, values, raw.log_time_ns), kind)
    assert_same_record(found, expected, tolerance=0.0)


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
