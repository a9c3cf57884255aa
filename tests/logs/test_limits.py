"""No file is taken into memory as far as it asks for."""

from __future__ import annotations

import logging
import struct
from dataclasses import replace
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
import zstandard

from logs.container.limits import ReadingLimits
from logs.errors import UnreadableLogError
from logs.messages import ObjectDetections, Odometry
from logs.reader import LogReader
from logs.selection import Selection
from logs.storage.mcap_index import MAGIC, MESSAGE_HEADER
from logs.summary import summarize
from logs.writer import LogWriter
from tests.fuzz.mcap_file import Layout, McapFile, Message, read_file, write_file

ODOMETRY = Selection.of({"/odom": "odometry"})
OBJECTS = Selection.of({"/objects": "detections"})


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> McapFile:
    path = tmp_path_factory.mktemp("limits") / "log.mcap"
    with LogWriter(path) as writer:
        for i in range(1, 31):
            writer.write("/odom", Odometry(i, np.eye(4)))
    return read_file(str(path))


def written(path: Path, file: McapFile, **layout: object) -> Path:
    path.write_bytes(write_file(file, Layout(**{"messages_per_chunk": 10, **layout})))  # type: ignore[arg-type]
    return path


def read(
    path: Path, limits: ReadingLimits | None = None, selection: Selection = ODOMETRY
) -> tuple[int, dict[str, int]]:
    with LogReader(path, limits) as reader:
        return len(list(reader.records(selection))), reader.counters


@pytest.mark.parametrize("has_index", [True, False])
def test_a_chunk_that_says_it_is_too_large_is_left_out(file, tmp_path, caplog, has_index):
    path = written(tmp_path / "log.mcap", file, declared_size=2**60, has_index=has_index)
    with caplog.at_level(logging.WARNING):
        assert read(path) == (0, {"chunks_too_large": 3})
    assert "limits.chunk_mb = 64" in caplog.text


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
@pytest.mark.parametrize("declared", [100, 10_000_000])
def test_a_chunk_that_holds_more_or_less_than_it_says_is_left_out(file, tmp_path, compression, declared):
    path = written(tmp_path / "log.mcap", file, declared_size=declared, compression=compression)
    count, counters = read(path)
    assert (count, counters["lost_chunks"]) == (0, 3)


@pytest.mark.parametrize("compress", [zstandard.compress, lz4.frame.compress])
def test_no_more_is_decompressed_than_a_chunk_says(monkeypatch, tmp_path, compress):
    from logs.storage import mcap_index

    name = "zstd" if compress is zstandard.compress else "lz4"
    sizes = []
    inner = mcap_index.decompress
    monkeypatch.setattr(mcap_index, "decompress", lambda *a: sizes.append(len(found := inner(*a))) or found)  # type: ignore[func-returns-value]
    data = compress(b"\0" * 50_000_000)
    head = struct.pack("<QQQI", 0, 1, 1000, 0) + struct.pack("<I", len(name)) + name.encode()
    chunk = head + struct.pack("<Q", len(data)) + data
    path = tmp_path / "log.mcap"
    path.write_bytes(MAGIC + struct.pack("<BQ", 6, len(chunk)) + chunk)
    assert read(path)[1]["lost_chunks"] == 1
    assert all(size <= 1001 for size in sizes)


def test_what_a_summary_that_is_none_points_to_is_not_decompressed(file, tmp_path):
    path = written(tmp_path / "log.mcap", file, summary_start=len(MAGIC))
    assert read(path) == (30, {})


def test_too_many_channels_are_refused(tmp_path):
    channels = {i: (0, f"/topic_{i}", "json") for i in range(5000)}
    for has_index in (True, False):
        path = written(tmp_path / "log.mcap", McapFile({}, channels, [Message(1, 1, b"")]), has_index=has_index)
        with pytest.raises(UnreadableLogError, match=r"more than 4096 channels.*--set memory_mb="):
            LogReader(path)
        with LogReader(path, ReadingLimits(channels=5000)) as reader:
            assert len(reader.topics()) == 5000


def test_a_topic_with_an_endless_name_is_refused(tmp_path):
    path = written(tmp_path / "log.mcap", McapFile({}, {1: (0, "x" * 2000, "json")}, [Message(1, 1, b"")]))
    with pytest.raises(UnreadableLogError, match=r"2000 characters.*--set memory_mb=128"):
        LogReader(path)


def test_a_message_that_is_too_large_is_left_out(file, tmp_path, caplog):
    large = replace(file.messages[4], data=b"x" * 5000)
    messages = [*file.messages[:4], large, *file.messages[5:]]
    path = written(tmp_path / "log.mcap", McapFile(file.schemas, file.channels, messages))
    assert read(path, ReadingLimits(message_mb=0.004)) == (29, {"messages_too_large": 1})
    assert "limits.message_mb" in caplog.text


def test_a_record_outside_of_chunks_that_is_too_large_is_passed_over(file, tmp_path):
    whole = written(tmp_path / "log.mcap", file, has_index=False).read_bytes()
    large = MESSAGE_HEADER.pack(1, 0, 5, 5) + b"x" * 5000
    path = tmp_path / "large.mcap"
    path.write_bytes(MAGIC + struct.pack("<BQ", 5, len(large)) + large + whole[len(MAGIC) :])
    assert read(path, ReadingLimits(message_mb=0.004)) == (30, {"chunks_too_large": 1})


def test_what_waits_for_its_turn_is_limited(file, tmp_path):
    path = written(tmp_path / "log.mcap", file, chunk_times=(0, 100))
    assert read(path)[0] == 30
    with pytest.raises(UnreadableLogError, match=r"overlap in time.*limits\.waiting_mb"):
        read(path, ReadingLimits(waiting_mb=0.001))


def test_metadata_beyond_the_limit_is_left_out(tmp_path, caplog):
    with LogWriter(tmp_path / "log.mcap") as writer:
        writer.add_metadata("small", {"a": "1"})
        writer.add_metadata("large", {"a": "1" * 100_000})
        writer.write("/odom", Odometry(1, np.eye(4)))
    with LogReader(tmp_path / "log.mcap", ReadingLimits(metadata_mb=0.05)) as reader:
        assert reader.metadata() == {"small": {"a": "1"}}
    assert "limits.metadata_mb" in caplog.text


def test_an_index_that_names_a_chunk_twice_gives_its_messages_once(file, tmp_path):
    path = written(tmp_path / "log.mcap", file, doubled_index=True)
    assert read(path)[0] == 30


@pytest.mark.parametrize("time_ns", [2**62, 2**63, 2**64 - 1])
def test_times_after_the_next_century_are_left_out(file, tmp_path, time_ns):
    messages = [*file.messages[:29], replace(file.messages[29], log_time_ns=time_ns)]
    path = written(tmp_path / "log.mcap", McapFile(file.schemas, file.channels, messages))
    assert read(path) == (29, {"messages_without_time": 1})
    assert summarize(path).counters["messages_without_time"] == 1


def objects_log(path: Path, labels: list[tuple[str, ...]]) -> Path:
    with LogWriter(path) as writer:
        for i, names in enumerate(labels):
            record = ObjectDetections(i + 1, "lidar", np.zeros((len(names), 3)), names, np.ones(len(names)))
            writer.write("/objects", record)
    return path


def test_a_message_with_too_many_objects_is_left_out(tmp_path):
    path = objects_log(tmp_path / "log.mcap", [("tree",) * 10, ("tree",) * 11])
    assert read(path, ReadingLimits(objects=10), OBJECTS) == (1, {"invalid_messages": 1})


def test_a_message_of_measurements_is_not_parsed_if_it_is_much_too_large(tmp_path):
    path = objects_log(tmp_path / "log.mcap", [("tree",) * 200])
    with LogReader(path, ReadingLimits(objects=10)) as reader:
        (raw,) = reader.messages()
    assert len(raw.data) > ReadingLimits(objects=10).input_bytes
    assert read(path, ReadingLimits(objects=10), OBJECTS) == (0, {"invalid_messages": 1})


def test_the_summary_counts_the_rarest_of_too_many_classes_as_one(tmp_path, monkeypatch):
    monkeypatch.setattr("logs.summary.MAX_CLASSES", 10)
    labels = [("tree", *(f"class {i}" for i in range(k, k + 8))) for k in range(0, 80, 8)]
    counts = summarize(objects_log(tmp_path / "log.mcap", labels)).class_counts
    assert counts["tree"] == 10
    assert sum(counts.values()) == 90
    assert len(counts) <= 12


def test_a_class_with_an_endless_name_is_left_out(tmp_path):
    path = objects_log(tmp_path / "log.mcap", [("tree",), ("x" * 1001,)])
    assert read(path, None, OBJECTS) == (1, {"invalid_messages": 1})
