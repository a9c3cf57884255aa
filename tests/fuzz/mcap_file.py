"""An MCAP file as a list of records that can be altered and written again with right lengths, indexes and checksums."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass, field, replace

import lz4.frame
import numpy as np
import zstandard

from logs.reader import LogReader
from logs.storage.mcap_index import MAGIC, MESSAGE_HEADER

_U8, _U16, _U32, _U64 = (struct.Struct(f"<{letter}").pack for letter in "BHIQ")


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


def _text(value: str | bytes) -> bytes:
    data = value if isinstance(value, bytes) else value.encode(errors="surrogatepass")
    return _U32(len(data)) + data


def _map(values: dict[str, str]) -> bytes:
    return _text(b"".join(_text(k) + _text(v) for k, v in values.items()))


def _record(opcode: int, content: bytes) -> bytes:
    return _U8(opcode) + _U64(len(content)) + content


def _schema(id: int, schema: tuple[str, str, bytes]) -> bytes:
    name, encoding, data = schema
    return _record(0x03, _U16(id) + _text(name) + _text(encoding) + _text(data))


def _channel(id: int, channel: tuple[int, str, str]) -> bytes:
    schema_id, topic, encoding = channel
    return _record(0x04, _U16(id) + _U16(schema_id) + _text(topic) + _text(encoding) + _map({}))


def compress(data: bytes, compression: str) -> bytes:
    if compression == "zstd":
        return zstandard.compress(data)
    return lz4.frame.compress(data) if compression == "lz4" else data


def write_file(file: McapFile, layout: Layout) -> bytes:
    """The bytes of ``file``, whole and valid but for the lies of ``layout``."""
    out = bytearray(MAGIC + _record(0x01, _text("") + _text("fuzz")))
    definitions = b"".join(_schema(*item) for item in file.schemas.items())
    definitions += b"".join(_channel(*item) for item in file.channels.items())
    indexes: list[bytes] = []
    for start in range(0, len(file.messages), layout.messages_per_chunk):
        messages = file.messages[start : start + layout.messages_per_chunk]
        content = bytearray(definitions)
        entries: dict[int, list[tuple[int, int]]] = {}
        for m in messages:
            entries.setdefault(m.channel, []).append((m.log_time_ns, len(content)))
            head = MESSAGE_HEADER.pack(m.channel, m.sequence, m.log_time_ns, m.log_time_ns)
            content += _record(0x05, head + m.data)
        times = [m.log_time_ns for m in messages]
        first_ns, last_ns = layout.chunk_times or (min(times), max(times))
        size = len(content) if layout.declared_size is None else layout.declared_size
        compressed = compress(bytes(content), layout.compression)
        crc = zlib.crc32(bytes(content))
        offset = len(out)
        out += _record(
            0x06,
            _U64(first_ns) + _U64(last_ns) + _U64(size) + _U32(crc) + _text(layout.compression) + _U64(len(compressed))
            + compressed,
        )  # fmt: skip
        chunk_length = len(out) - offset
        places = b""
        index_start = len(out)
        for channel, pairs in entries.items():
            places += _U16(channel) + _U64(len(out))
            pairs = pairs * 2 if layout.doubled_index else pairs
            out += _record(0x07, _U16(channel) + _text(b"".join(_U64(t) + _U64(p) for t, p in pairs)))
        indexes.append(
            _record(
                0x08,
                _U64(first_ns) + _U64(last_ns) + _U64(offset) + _U64(chunk_length) + _text(places)
                + _U64(len(out) - index_start) + _text(layout.compression) + _U64(len(compressed)) + _U64(size),
            )
        )  # fmt: skip
    metadata_indexes = []
    for name, values in file.metadata:
        offset = len(out)
        out += _record(0x0C, _text(name) + _map(values))
        metadata_indexes.append(_record(0x0D, _U64(offset) + _U64(len(out) - offset) + _text(name)))
    out += _record(0x0F, _U32(0))
    summary_start = len(out)
    if layout.has_index:
        counts: dict[int, int] = {}
        for m in file.messages:
            counts[m.channel] = counts.get(m.channel, 0) + 1
        times = [m.log_time_ns for m in file.messages] or [0]
        statistics = (
            _U64(len(file.messages)) + _U16(len(file.schemas)) + _U32(len(file.channels)) + _U32(0)
            + _U32(len(file.metadata)) + _U32(len(indexes)) + _U64(min(times)) + _U64(max(times))
            + _text(b"".join(_U16(c) + _U64(n) for c, n in counts.items()))
        )  # fmt: skip
        repeated = indexes * 2 if layout.doubled_index else indexes
        out += definitions + b"".join(repeated) + b"".join(metadata_indexes) + _record(0x0B, statistics)
    start = layout.summary_start if layout.summary_start is not None else (summary_start if layout.has_index else 0)
    footer = _U64(start) + _U64(0)
    crc = zlib.crc32(bytes(out[summary_start:]) + _U8(0x02) + _U64(20) + footer) if layout.has_index else 0
    return bytes(out + _record(0x02, footer + _U32(crc)) + MAGIC)


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
