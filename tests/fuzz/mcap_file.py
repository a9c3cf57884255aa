"""An MCAP file as a list of records that can be altered and written again with right lengths, indexes and checksums."""

from __future__ import annotations

import zlib
from collections import Counter
from dataclasses import dataclass, field, replace

import lz4.frame
import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)
from mcap.records import Message as MessageRecord

from logs.reader import LogReader
from logs.storage.mcap_index import MAGIC


@dataclass(frozen=True)
class Message:
    channel: int
    log_time_ns: int
    data: bytes
    sequence: int = 0


@dataclass
class McapFile:
    """What stands in the file; ``channels`` are their ids with the schema's id, the topic and the encoding."""

    schemas: dict[int, tuple[str, str, bytes]] = field(default_factory=dict)
    channels: dict[int, tuple[int, str, str]] = field(default_factory=dict)
    messages: list[Message] = field(default_factory=list)
    metadata: list[tuple[str, dict[str, str]]] = field(default_factory=list)

    def copy(self) -> McapFile:
        return McapFile(dict(self.schemas), dict(self.channels), list(self.messages), list(self.metadata))


@dataclass(frozen=True)
class Layout:
    """How it is written, and what is said of it that is not so."""

    compression: str = "zstd"
    messages_per_chunk: int = 100
    has_index: bool = True
    doubled_index: bool = False
    declared_size: int | None = None
    chunk_times: tuple[int, int] | None = None
    summary_start: int | None = None


def read_file(path: str) -> McapFile:
    file = McapFile()
    with LogReader(path) as reader:
        numbers: dict[int, int] = {}
        for raw in reader.messages():
            number = numbers.get(raw.channel.id)
            if number is None:
                number = numbers[raw.channel.id] = len(numbers) + 1
                schema = raw.channel.schema
                if schema is not None:
                    file.schemas[schema.id] = (schema.name, schema.encoding, schema.data)
                file.channels[number] = (schema.id if schema else 0, raw.channel.topic, raw.channel.message_encoding)
            file.messages.append(Message(number, raw.log_time_ns, raw.data, raw.sequence))
        file.metadata = list(reader.metadata().items())
    return file


def encoded(*records: McapRecord) -> bytes:
    """The bytes of records, one after the other."""
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return builder.end()


def channel_record(id: int, schema: int, topic: str, encoding: str) -> Channel:
    return Channel(id, topic, encoding, {}, schema)


def compress(data: bytes, compression: str) -> bytes:
    if compression == "zstd":
        return zstandard.compress(data)
    return lz4.frame.compress(data) if compression == "lz4" else data


def write_file(file: McapFile, layout: Layout) -> bytes:
    """The bytes of ``file``, whole and valid but for the lies of ``layout``."""
    out = bytearray(MAGIC + encoded(Header("", "fuzz")))
    definitions = encoded(
        *(Schema(id, data, encoding, name) for id, (name, encoding, data) in file.schemas.items()),
        *(channel_record(id, *channel) for id, channel in file.channels.items()),
    )
    chunks = [
        _append_chunk(out, definitions, file.messages[start : start + layout.messages_per_chunk], layout)
        for start in range(0, len(file.messages), layout.messages_per_chunk)
    ]
    metadata = [_append_metadata(out, *each) for each in file.metadata]
    out += encoded(DataEnd(0))
    summary_start = len(out)
    if layout.has_index:
        repeated = chunks * 2 if layout.doubled_index else chunks
        out += definitions + encoded(*repeated, *metadata, _statistics(file, len(chunks)))
    start = layout.summary_start if layout.summary_start is not None else (summary_start if layout.has_index else 0)
    crc = zlib.crc32(bytes(out[summary_start:]) + encoded(Footer(start, 0, 0))[:-4]) if layout.has_index else 0
    return bytes(out + encoded(Footer(start, 0, crc)) + MAGIC)


def _append_chunk(out: bytearray, definitions: bytes, messages: list[Message], layout: Layout) -> ChunkIndex:
    """Write a chunk and the index of its messages; returns what the summary says of it."""
    content = bytearray(definitions)
    entries: dict[int, list[tuple[int, int]]] = {}
    for m in messages:
        entries.setdefault(m.channel, []).append((m.log_time_ns, len(content)))
        content += encoded(MessageRecord(m.channel, m.log_time_ns, m.data, m.log_time_ns, m.sequence))
    times = [m.log_time_ns for m in messages]
    first_ns, last_ns = layout.chunk_times or (min(times), max(times))
    size = len(content) if layout.declared_size is None else layout.declared_size
    compressed = compress(bytes(content), layout.compression)
    offset = len(out)
    out += encoded(Chunk(layout.compression, compressed, last_ns, first_ns, zlib.crc32(bytes(content)), size))
    index_start, offsets = len(out), {}
    for channel, pairs in entries.items():
        offsets[channel] = len(out)
        out += encoded(MessageIndex(channel, pairs * 2 if layout.doubled_index else pairs))
    return ChunkIndex(
        chunk_length=index_start - offset,
        chunk_start_offset=offset,
        compression=layout.compression,
        compressed_size=len(compressed),
        message_end_time=last_ns,
        message_index_length=len(out) - index_start,
        message_index_offsets=offsets,
        message_start_time=first_ns,
        uncompressed_size=size,
    )


def _append_metadata(out: bytearray, name: str, values: dict[str, str]) -> MetadataIndex:
    offset = len(out)
    out += encoded(Metadata(name, values))
    return MetadataIndex(offset, len(out) - offset, name)


def _statistics(file: McapFile, chunks: int) -> Statistics:
    times = [m.log_time_ns for m in file.messages] or [0]
    return Statistics(
        attachment_count=0,
        channel_count=len(file.channels),
        channel_message_counts=Counter(m.channel for m in file.messages),
        chunk_count=chunks,
        message_count=len(file.messages),
        message_end_time=max(times),
        message_start_time=min(times),
        metadata_count=len(file.metadata),
        schema_count=len(file.schemas),
    )


def odd_layout(rng: np.random.Generator) -> Layout:
    layout = Layout(
        compression=str(rng.choice(["zstd", "lz4", ""])),
        messages_per_chunk=int(rng.choice([1, 7, 100, 10_000])),
        has_index=bool(rng.random() < 0.8),
        doubled_index=bool(rng.random() < 0.1),
    )
    if rng.random() < 0.1:
        layout = replace(layout, declared_size=int(rng.choice(np.array([0, 1, 2**30, 2**60, 2**64 - 1], dtype=object))))
    if rng.random() < 0.1:
        layout = replace(layout, chunk_times=tuple(int(t) for t in rng.choice([0, 5, 2**62, 2**63 - 1], 2)))
    if rng.random() < 0.03:
        layout = replace(layout, summary_start=int(rng.choice([8, 100, 2**40, 2**63 - 1])))
    return layout
