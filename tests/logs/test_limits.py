"""No file is taken into memory as far as it asks for."""

import logging
from dataclasses import replace
from pathlib import Path
from typing import Any

import lz4.frame
import numpy as np
import pytest
import zstandard

from logs.container.limits import ReadingLimits
from logs.decoders.decode import decode
from logs.errors import InvalidRecordError, UnreadableLogError
from logs.messages import Odometry
from logs.reader import LogReader
from logs.selection import Selection
from logs.storage import mcap_index
from logs.storage.mcap_index import MAGIC
from logs.summary import summarize
from logs.topics import Channel, RawMessage, RecordKind
from tests.fuzz.mcap_file import Layout, McapFile, Message, read_file, write_file
from tests.helpers.landmarks import detections_of
from tests.helpers.short_drives import write_records

TOPICS = Selection.of({"/odom": "odometry", "/objects": "detections"})


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> McapFile:
    path = tmp_path_factory.mktemp("limits") / "log.mcap"
    return read_file(str(write_records(path, (("/odom", Odometry(i, np.eye(4))) for i in range(1, 31)))))


def read(path: Path, file: McapFile | None = None, /, limits: ReadingLimits | None = None, **layout: Any) -> Any:
    """The number of records and the counters of a log, of ``file`` if that is given."""
    if file is not None:
        path = path / "log.mcap"
        path.write_bytes(write_file(file, Layout(**{"messages_per_chunk": 10, **layout})))
    with LogReader(path, limits) as reader:
        return len(list(reader.records(TOPICS))), reader.counters


@pytest.mark.parametrize("has_index", [True, False])
def test_chunk_that_says_it_is_too_large_is_left_out(file, tmp_path, caplog, has_index):
    with caplog.at_level(logging.WARNING):
        found = read(tmp_path, file, chunk={"uncompressed_size": 2**60}, has_index=has_index)
    assert found == (0, {"chunks_too_large": 3})
    assert "more than memory_mb = 64 allows" in caplog.text


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
@pytest.mark.parametrize("declared", [100, 10_000_000])
def test_chunk_of_another_size_than_it_says_is_left_out(file, tmp_path, compression, declared):
    count, counters = read(tmp_path, file, chunk={"uncompressed_size": declared}, compression=compression)
    assert (count, counters["lost_chunks"]) == (0, 3)


def test_decompress_unpacks_no_more_than_a_chunk_says():
    zeros = bytes(10**6)
    assert len(mcap_index.decompress(lz4.frame.compress(zeros), "lz4", 1000)) == 1001
    with pytest.raises(ValueError, match="a frame of 1000000 bytes in a chunk of 1000"):
        mcap_index.decompress(zstandard.compress(zeros), "zstd", 1000)
    of_unknown_size = zstandard.ZstdCompressor(write_content_size=False).compress(zeros)
    with pytest.raises(zstandard.ZstdError, match="did not decompress full frame"):
        mcap_index.decompress(of_unknown_size, "zstd", 1000)


@pytest.mark.parametrize(
    "layout", [{"footer": {"summary_start": len(MAGIC), "summary_crc": 0}}, {"doubled_index": True}]
)
def test_false_summary_is_not_believed(file, tmp_path, layout):
    assert read(tmp_path, file, **layout)[0] == 30


@pytest.mark.parametrize("has_index", [True, False])
def test_too_many_channels_are_refused(tmp_path, has_index):
    many = McapFile({}, {i: (0, f"/topic_{i}", "json") for i in range(5000)}, [Message(1, 1, b"")])
    with pytest.raises(UnreadableLogError, match=r"channels or schemas, more than 4096; .*--set memory_mb=65"):
        read(tmp_path, many, has_index=has_index)
    read(tmp_path, many, limits=ReadingLimits(channels=5000), has_index=has_index)


def test_topic_with_endless_name_is_refused(tmp_path):
    with pytest.raises(UnreadableLogError, match=r"2000 characters.*--set memory_mb=128"):
        read(tmp_path, McapFile({}, {1: (0, "x" * 2000, "json")}, [Message(1, 1, b"")]))


def test_large_messages_are_left_out(file, tmp_path, caplog):
    limits = ReadingLimits(message_bytes=4000, objects=5)
    large = replace(file.messages[4], data=b"x" * 5000)
    altered = McapFile(file.schemas, file.channels, [*file.messages[:4], large, *file.messages[5:]])
    assert read(tmp_path, altered, limits=limits) == (29, {"invalid_messages": 1})
    assert "too many bytes for memory_mb" in caplog.text
    with pytest.raises(InvalidRecordError, match="too many bytes for memory_mb"):
        decode(RawMessage(Channel("/map", "protobuf", None), 5, 5, 0, b"x" * 5000), RecordKind.OBJECT_MAP, None, limits)
    outside_of_chunks = {"use_chunking": False, "has_index": False}
    assert read(tmp_path, altered, limits=limits, **outside_of_chunks) == (29, {"chunks_too_large": 1})


def test_what_waits_for_its_turn_is_limited(file, tmp_path):
    times = {"message_start_time": 0, "message_end_time": 100}
    assert read(tmp_path, file, chunk=times)[0] == 30
    with pytest.raises(UnreadableLogError, match=r"overlap in time.*memory_mb"):
        read(tmp_path, file, limits=ReadingLimits(waiting_bytes=1000), chunk=times)


def test_metadata_beyond_the_limit_is_left_out(tmp_path, caplog):
    path = write_records(tmp_path / "log.mcap", (), small={"a": "1"}, large={"a": "1" * 100_000})
    with LogReader(path, ReadingLimits(metadata_bytes=50_000)) as reader:
        assert reader.metadata() == {"small": {"a": "1"}}
    assert "metadata of 0.1 MB is more than" in caplog.text


@pytest.mark.parametrize("time_ns", [2**62, 2**64 - 1])
def test_times_after_the_next_century_are_left_out(file, tmp_path, time_ns):
    messages = [*file.messages[:29], replace(file.messages[29], log_time_ns=time_ns)]
    assert read(tmp_path, McapFile(file.schemas, file.channels, messages)) == (29, {"messages_without_time": 1})
    assert summarize(tmp_path / "log.mcap").counters["messages_without_time"] == 1


def objects_log(folder: Path, labels: list[tuple[str, ...]]) -> Path:
    scans = (detections_of(np.zeros((len(names), 3)), names, stamp_ns=i + 1) for i, names in enumerate(labels))
    return write_records(folder / "log.mcap", (("/objects", scan) for scan in scans))


@pytest.mark.parametrize("labels", [("tree",) * 11, ("x" * 1001,)])
def test_messages_with_too_many_objects_or_long_names_are_left_out(tmp_path, labels):
    path = objects_log(tmp_path, [("tree",) * 10, labels])
    assert read(path, limits=ReadingLimits(objects=10)) == (1, {"invalid_messages": 1})


def test_summary_counts_the_rarest_of_too_many_classes_as_one(tmp_path, monkeypatch):
    monkeypatch.setattr("logs.summary.MAX_CLASSES", 10)
    labels = [("tree", *(f"class {i}" for i in range(k, k + 8))) for k in range(0, 80, 8)]
    counts = summarize(objects_log(tmp_path, labels)).class_counts
    assert (counts["tree"], sum(counts.values()), len(counts) <= 12) == (10, 90, True)
