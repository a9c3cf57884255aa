"""Whatever is wrong with a file: a prefix of its records and a count, or one clear error, and nothing else."""

import struct
from io import BytesIO

import numpy as np
import pytest
from mcap.opcode import Opcode

from logs import messages as m
from logs.container.limits import ReadingLimits
from logs.errors import UnreadableLogError
from logs.reader import LogReader
from logs.selection import Selection
from logs.storage.mcap_index import McapIndex
from tests.fuzz.mcap_file import Layout, read_file, write_file
from tests.helpers.short_drives import write_records
from tests.logs.examples import random_detections, random_transform

COUNT = 4000
ODOMETRY = Selection.of({"/odom": "odometry"})


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    path, rng = tmp_path_factory.mktemp("damage") / "log.mcap", np.random.default_rng(11)
    records = []
    for stamp_ns in range(1, COUNT + 1):
        records.append(("/odom", m.Odometry(stamp_ns, random_transform(rng))))
        if stamp_ns % 100 == 1:
            records.append(("/detections", random_detections(rng, 5, stamp_ns=stamp_ns)))
    return write_records(path, records, configuration={"a": "1"}).read_bytes()


def read(folder, content):
    """Stamps of the odometry and counters of a log with that content."""
    path = folder / "log.mcap"
    path.write_bytes(content)
    with LogReader(path) as reader:
        found = [entry.record.stamp_ns for entry in reader.records(ODOMETRY)]
        return found, reader.counters


@pytest.mark.parametrize("cut", [8, 60, 300_001, -1, -30])
def test_truncated_log_gives_a_prefix_of_its_records(whole, tmp_path, cut):
    found, counters = read(tmp_path, whole[:cut])
    assert found == list(range(1, len(found) + 1))
    assert len(found) == COUNT if cut < 0 else 0 < len(found) < COUNT if cut > 300_000 else not found
    assert cut < 0 or counters["truncated"] == 1


def test_a_log_without_its_summary_is_read_whole(whole, tmp_path):
    path = tmp_path / "log.mcap"
    path.write_bytes(whole[: whole.rindex(struct.pack("<BQ", Opcode.DATA_END, 4))])
    with LogReader(path) as reader:
        assert [info.message_count for info in reader.topics()] == [COUNT // 100, COUNT]
        assert reader.metadata() == {"configuration": {"a": "1"}}
        assert len(list(reader.records(ODOMETRY))) == COUNT
        assert reader.counters == {"truncated": 1}


@pytest.mark.parametrize("with_summary", [True, False])
def test_a_chunk_with_a_bad_checksum_is_left_out_and_counted(whole, tmp_path, with_summary):
    chunk = McapIndex("", BytesIO(whole), ReadingLimits()).blocks[1]
    damaged = bytearray(whole)
    damaged[chunk.chunk_start_offset + 33] ^= 0xFF  # in the stored checksum: 9 bytes of header, two times, the size
    found, counters = read(tmp_path, damaged if with_summary else damaged[:-100])
    assert 0 < len(found) < COUNT
    assert found == sorted(set(range(1, COUNT + 1)) - set(range(chunk.message_start_time, chunk.message_end_time + 1)))
    assert counters["lost_chunks"] == 1
    assert counters["lost_bytes"] >= chunk.chunk_length


def test_summary_with_a_bad_checksum_is_not_believed(whole, tmp_path):
    damaged = bytearray(whole)
    damaged[whole.rindex(b"/odom")] ^= 0x01
    assert len(read(tmp_path, damaged)[0]) == COUNT


@pytest.mark.parametrize("layout", [Layout("lz4"), Layout("", has_index=False), Layout("", use_chunking=False)])
def test_other_layouts_are_read_alike(whole, tmp_path, layout):
    path = tmp_path / "log.mcap"
    path.write_bytes(whole)
    content = write_file(read_file(path), layout)
    assert read(tmp_path, content) == (list(range(1, COUNT + 1)), {})
    found, counters = read(tmp_path, content[: len(content) // 2])
    assert found == list(range(1, len(found) + 1))
    assert counters["truncated"] == 1
    assert layout.use_chunking or len(found) > COUNT // 3


@pytest.mark.parametrize(
    ("name", "content", "fault"), [("missing.mcap", None, "cannot read"), ("empty.mcap", "", r"empty\.mcap is empty")]
)
def test_log_reader_refuses_what_is_no_log(tmp_path, name, content, fault):
    if content is not None:
        (tmp_path / name).write_text(content)
    with pytest.raises(UnreadableLogError, match=fault):
        LogReader(tmp_path / name)
