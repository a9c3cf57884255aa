"""Values that the libraries under the readers do not take, each refused in one line or left out."""

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from logs.decoders.decode import decode
from logs.errors import InvalidRecordError, UnreadableLogError
from logs.storage.arrays import read_arrays
from logs.topics import Channel, RawMessage, RecordKind, Schema
from logs.writer import LogWriter
from tests.helpers.short_drives import metadata_of, write_records


def test_file_names_that_are_no_utf_8_can_be_recorded(tmp_path: Path) -> None:
    path = write_records(tmp_path / "a.mcap", (), source={"odometry": "\udcff.tum"})
    assert metadata_of(path) == {"source": {"odometry": "\\udcff.tum"}}


@pytest.mark.parametrize("header", ["{[]: 1}", "(" * 3000, "{1: 2, 'a': 3}"])
def test_arrays_whose_header_is_another_expression(tmp_path: Path, header: str) -> None:
    path = tmp_path / "a.mcap"
    content = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header) + 1) + header.encode() + b"\n" + bytes(64)
    with LogWriter(path) as writer:
        writer._writer.add_attachment(0, 0, "a", "a", content)
    with pytest.raises(UnreadableLogError, match="cannot be read as an array"):
        read_arrays(path)


def detections_message(seconds: str, frame: str) -> RawMessage:
    """A vision_msgs/msg/Detection3DArray without detections, by a definition with other types of its time and frame."""
    name, line = "vision_msgs/msg/Detection3DArray", f"\n{'=' * 80}\nMSG: "
    parts = {"std_msgs/Header": f"my/Time stamp\n{frame} frame_id", "my/Time": f"{seconds} sec\nuint32 nanosec"}
    text = "std_msgs/Header header\nuint8[] detections" + "".join(f"{line}{part}\n{of}" for part, of in parts.items())
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(text, name))
    values: dict[str, Any] = {"float64": 1.5e9, "int32": 1, "string": "a"}
    stamp = store.types["my/msg/Time"](values[seconds], 0)
    header = store.types["std_msgs/msg/Header"](stamp, values[frame])
    message = store.types[name](header, np.zeros(0, np.uint8))
    data = bytes(store.serialize_cdr(message, name))
    return RawMessage(Channel("/objects", "cdr", Schema(name, "ros2msg", text.encode())), 5, 5, 0, data)


def test_definitions_that_say_other_types_than_usual() -> None:
    (record,) = decode(detections_message("int32", "string"), RecordKind.DETECTIONS)
    assert record.stamp_ns == 10**9
    with pytest.raises(InvalidRecordError, match="give a string"):
        decode(detections_message("int32", "int32"), RecordKind.DETECTIONS)
    for seconds in ("float64", "string"):
        with pytest.raises(InvalidRecordError, match="a field has an unexpected type"):
            decode(detections_message(seconds, "string"), RecordKind.DETECTIONS)
