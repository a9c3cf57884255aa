"""Detections in messages of other schemas, by the names of their fields."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import get_types_from_msg

from logs.decoders.decode import decode
from logs.decoders.field_mapping import FieldMapping
from logs.decoders.ros2_types import TYPES
from logs.errors import TopicSelectionError
from logs.messages import ObjectDetections, Odometry
from logs.reader import LogReader
from logs.selection import select_topics
from logs.topics import Channel, RawMessage, RecordKind, Schema
from logs.writer import LogWriter
from tests.helpers.ros2_logs import encoded, header, vector

PLANT = "string kind\nfloat32 sure\ngeometry_msgs/Point place"
PLANTS = "std_msgs/Header header\nfarm_msgs/Plant[] plants"
MAPPING = "/plants:plants[] position=place label=kind score=sure"
TREE: dict[str, Any] = {"kind": "tree", "sure": 0.5, "place": vector(1, 2, 3)}
SEEN = [TREE, {"kind": "pole", "place": vector(4, 5, 6)}]


@pytest.fixture(params=["cdr", "json"])
def log(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    for name, text in (("farm_msgs/msg/Plant", PLANT), ("farm_msgs/msg/Plants", PLANTS)):
        types = get_types_from_msg(text, name)
        if name not in TYPES.fielddefs:
            TYPES.register(types)
    values = {"header": header(5, "lidar"), "plants": SEEN}
    raw = encoded(("/plants", "farm_msgs/msg/Plants", 9, values))
    if request.param == "json":
        plants = [{"sure": 1.0, **plant} for plant in SEEN]
        channel = Channel("/plants", "json", Schema("Plants", "jsonschema", b"{}"))
        raw = RawMessage(channel, 9, 9, 0, json.dumps({**values, "plants": plants}).encode())
    with LogWriter(tmp_path / "log.mcap") as writer:
        writer.write("/odom", Odometry(1, np.eye(4)))
        writer.write_raw(raw)
        writer.write_raw(replace(raw, data=raw.data[:20]))
    return tmp_path / "log.mcap"


def test_fields_of_own_messages_become_detections(log: Path) -> None:
    with LogReader(log) as reader:
        selection = select_topics(reader.topics(), {"detections": MAPPING})
        (_, entry) = reader.records(selection)
        assert reader.counters == {"invalid_messages": 1}
    record = entry.record
    assert (record.stamp_ns, record.frame_id, record.labels) == (5, "lidar", ("tree", "pole"))
    assert record.scores[0] == 0.5
    np.testing.assert_array_equal(record.positions, [[1, 2, 3], [4, 5, 6]])


def test_numbers_are_a_position_and_a_message_without_header_is_of_its_log_time() -> None:
    raw = RawMessage(Channel("/plants", "json", None), 9, 9, 0, b'[{"at": [1, 2]}]')
    (record,) = decode(raw, RecordKind.DETECTIONS, mapping=FieldMapping.parse("[] position=at"))
    assert isinstance(record, ObjectDetections)
    assert (record.stamp_ns, record.frame_id, record.positions.tolist()) == (9, "", [[1.0, 2.0, 0.0]])


@pytest.mark.parametrize("fields", ["plants[] label=kind", "plants[] position=place colour=kind"])
def test_mapping_without_position_or_with_unknown_part_is_refused(log: Path, fields: str) -> None:
    with LogReader(log) as reader, pytest.raises(TopicSelectionError, match="is not a field mapping; write"):
        select_topics(reader.topics(), {"detections": f"/plants:{fields}"})


def test_field_that_is_not_there_is_named(log: Path, caplog: pytest.LogCaptureFixture) -> None:
    with LogReader(log) as reader:
        selection = select_topics(reader.topics(), {"detections": "/plants:plants[] position=at"})
        assert len(list(reader.records(selection))) == 1
        assert reader.counters == {"invalid_messages": 2}
    assert "no such field ('at' among" in caplog.text


def test_unknown_schema_is_refused_with_the_way_to_map_it(log: Path) -> None:
    with LogReader(log) as reader, pytest.raises(TopicSelectionError, match="does not decode to detections; name its"):
        select_topics(reader.topics(), {"detections": "/plants"})
