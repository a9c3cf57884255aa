"""What a file holds and where: from its summary, or, where that is missing or false, from a walk through it."""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from io import BytesIO
from typing import BinaryIO, TypeVar

import numpy as np
import zstandard
from mcap import records as mcap_records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.reader import SeekingReader
from mcap.summary import Summary

from logs import blocks
from logs.blocks import Block
from logs.container.chunks import OversizedChunkError, read_chunk
from logs.container.limits import ReadingLimits
from logs.errors import UnreadableLogError
from logs.topics import Channel, Schema
from logs.validation import LAST_NS

# Whatever decompressing or parsing damaged bytes may raise.
DAMAGE = (McapError, ValueError, RuntimeError, MemoryError, OverflowError, struct.error, EOFError, zstandard.ZstdError)

_Record = TypeVar("_Record")
_FOOTER = struct.Struct("<QQI")  # summary start, summary offset start, checksum of all from the summary start to here
_INDEX_HEAD = struct.Struct("<HI")  # channel, bytes of what follows
_LARGEST_SUMMARY = 16_000_000  # bytes; parsed it takes some ten times that
_MOST_BLOCKS = 500_000
_OF_A_SUMMARY = frozenset({0x02, blocks.SCHEMA, blocks.CHANNEL, 0x08, 0x0A, 0x0B, 0x0D, 0x0E})


@dataclass(slots=True)
class FileIndex:
    """Channels, counts and places. ``lost_blocks``: offset -> bytes; ``oversized``: offset -> bytes, decompressed.

    The first and last log times by channel are missing where the index of the file does not tell them.
    """

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    message_counts: Counter[int] = field(default_factory=Counter)
    first_ns: dict[int, int] = field(default_factory=dict)
    last_ns: dict[int, int] = field(default_factory=dict)
    blocks: list[Block] = field(default_factory=list)
    metadata_offsets: list[int] = field(default_factory=list)
    attachment_offsets: list[int] = field(default_factory=list)
    is_complete: bool = True
    lost_tail_bytes: int = 0
    lost_blocks: dict[int, int] = field(default_factory=dict)
    oversized: dict[int, int] = field(default_factory=dict)


class IndexedFile:
    """An MCAP file of ``size`` bytes and its index.

    Raises:
        UnreadableLogError: it holds more channels or blocks, or longer names, than the limits allow.
    """

    def __init__(self, name: str, stream: BinaryIO, size: int, limits: ReadingLimits) -> None:
        self._name = name
        self._stream = stream
        self._size = size
        self._limits = limits
        self.index = FileIndex()
        summary = self._usable_summary()
        if summary is None:
            self._index_by_walking()
        else:
            self._index_by_summary(summary)
        self.index.blocks.sort(key=lambda block: (block.start_ns, block.offset))

    def load(self, block: Block) -> bytes | None:
        """The records of ``block``, decompressed and checked; None, and noted in the index, if it is damaged or too
        large.

        Raises:
            UnreadableLogError: the disk fails.
        """
        try:
            if block.is_chunk:
                return read_chunk(self._stream, block, self._limits.chunk_bytes)
            self._stream.seek(block.offset)
            return self._stream.read(block.length)
        except OSError as error:
            raise UnreadableLogError(f"cannot read on in {self._name}: {error.strerror}; check the disk") from error
        except OversizedChunkError as error:
            self.index.oversized[block.offset] = error.size
        except DAMAGE:
            self.index.lost_blocks[block.offset] = block.length
        return None

    def read_record(self, offset: int, read: Callable[[ReadDataStream], _Record], max_bytes: int) -> _Record | None:
        """The record at ``offset``; None if it is damaged or longer than ``max_bytes``."""
        try:
            return read(_stream_of(self._content_at(offset, max_bytes)))
        except DAMAGE:
            self.index.lost_blocks[offset] = 0
            return None

    def length_at(self, offset: int) -> int:
        """Bytes of the record at ``offset``, 0 if there is none."""
        if not 0 <= offset <= self._size - blocks.HEADER.size:
            return 0
        self._stream.seek(offset)
        return int(blocks.HEADER.unpack(self._stream.read(blocks.HEADER.size))[1])

    def _content_at(self, offset: int, max_bytes: int) -> bytes:
        length = self.length_at(offset)
        if length > min(max_bytes, self._size - offset):
            raise ValueError(f"record of {length} bytes at {offset}")
        return self._stream.read(length)

    def _usable_summary(self) -> Summary | None:
        """The summary of the file, if it is there, whole, and tells all that reading by it needs."""
        try:
            self._stream.seek(max(self._size - len(blocks.MAGIC) - _FOOTER.size, 0))
            summary_start, _, checksum = _FOOTER.unpack(self._stream.read(_FOOTER.size))
            length = self._size - len(blocks.MAGIC) - summary_start
            if not 0 < length <= _LARGEST_SUMMARY or summary_start < len(blocks.MAGIC):
                return None
            self._stream.seek(summary_start)
            covered = self._stream.read(length)
            opcodes = Counter(opcode for opcode, _, _ in blocks.records(covered))
            if not _OF_A_SUMMARY.issuperset(opcodes) or checksum not in (0, zlib.crc32(covered[:-4])):
                return None
            self._limits.check_channels(self._name, max(opcodes[blocks.SCHEMA], opcodes[blocks.CHANNEL]))
            self._stream.seek(0)
            summary = SeekingReader(self._stream).get_summary()
        except (*DAMAGE, OSError):
            return None
        return summary if summary is not None and self._is_enough(summary) else None

    def _is_enough(self, summary: Summary) -> bool:
        statistics = summary.statistics
        return (
            statistics is not None
            and (len(summary.chunk_indexes) > 0 or statistics.message_count == 0)
            and all(id in summary.channels for id in statistics.channel_message_counts)
            and all(c.schema_id == 0 or c.schema_id in summary.schemas for c in summary.channels.values())
            and all(c.chunk_start_offset + c.chunk_length <= self._size for c in summary.chunk_indexes)
            and len({c.chunk_start_offset for c in summary.chunk_indexes}) == len(summary.chunk_indexes)
            and len(summary.metadata_indexes) == statistics.metadata_count
            and len(summary.attachment_indexes) == statistics.attachment_count
        )

    def _index_by_summary(self, summary: Summary) -> None:
        index = self.index
        for schema in summary.schemas.values():
            self._add_schema(schema)
        for channel in summary.channels.values():
            self._add_channel(channel)
        if summary.statistics is not None:
            index.message_counts.update(summary.statistics.channel_message_counts)
        index.metadata_offsets = [each.offset for each in summary.metadata_indexes]
        index.attachment_offsets = [each.offset for each in summary.attachment_indexes]
        shared: dict[frozenset[int], frozenset[int]] = {}  # most chunks hold the same channels
        for c in summary.chunk_indexes:
            ids = frozenset(c.message_index_offsets)
            ids = shared.setdefault(ids, ids)
            index.blocks.append(
                Block(c.chunk_start_offset, c.chunk_length, c.message_start_time, c.message_end_time, True, ids or None)
            )
        try:
            self._read_time_spans(summary.chunk_indexes)
        except (*DAMAGE, OSError):
            index.first_ns, index.last_ns = {}, {}  # the times are only for show

    def _read_time_spans(self, chunks: list[mcap_records.ChunkIndex]) -> None:
        """First and last log time of each channel, from the message indexes of the few chunks that can hold them."""
        first, last = self.index.first_ns, self.index.last_ns
        for chunk in sorted(chunks, key=lambda c: c.message_start_time):
            for id, offset in chunk.message_index_offsets.items():
                if id not in first or chunk.message_start_time < first[id]:
                    found = int(self._indexed_times(offset).min())
                    first[id] = min(found, first.get(id, found))
        for chunk in sorted(chunks, key=lambda c: -c.message_end_time):
            for id, offset in chunk.message_index_offsets.items():
                if id not in last or chunk.message_end_time > last[id]:
                    found = int(self._indexed_times(offset).max())
                    last[id] = max(found, last.get(id, found))

    def _indexed_times(self, offset: int) -> np.ndarray[tuple[int], np.dtype[np.uint64]]:
        """Log times in the message index at ``offset``, at least one."""
        content = self._content_at(offset, self._limits.chunk_bytes)
        _, length = _INDEX_HEAD.unpack_from(content)
        times = np.frombuffer(content, dtype="<u8", count=length // 8, offset=_INDEX_HEAD.size)[::2]
        if len(times) == 0:
            raise ValueError(f"an empty message index at {offset}")
        return times

    def _index_by_walking(self) -> None:
        found = blocks.walk(self._stream, self._size, self._limits.message_bytes)
        index = self.index
        if len(found.blocks) > _MOST_BLOCKS:
            raise UnreadableLogError(
                f"{self._name} has {len(found.blocks)} chunks and no index; write it again with larger ones"
            )
        index.is_complete = found.is_complete
        index.lost_tail_bytes = found.lost_bytes
        index.metadata_offsets = found.metadata_offsets
        index.attachment_offsets = found.attachment_offsets
        index.oversized.update(found.oversized)
        for block in found.blocks:
            content = self.load(block)
            if content is None:
                continue
            try:
                self._index_content(content)
            except DAMAGE:
                index.lost_blocks[block.offset] = block.length
            else:
                index.blocks.append(block)

    def _index_content(self, content: bytes) -> None:
        index = self.index
        for opcode, begin, end in blocks.records(content):
            if opcode == blocks.MESSAGE:
                id, _, log_time_ns, _ = blocks.MESSAGE_HEADER.unpack_from(content, begin)
                index.message_counts[id] += 1
                if log_time_ns <= LAST_NS:
                    index.first_ns[id] = min(log_time_ns, index.first_ns.get(id, log_time_ns))
                    index.last_ns[id] = max(log_time_ns, index.last_ns.get(id, log_time_ns))
            elif opcode == blocks.SCHEMA:
                self._add_schema(mcap_records.Schema.read(_stream_of(content[begin:end])))
            elif opcode == blocks.CHANNEL:
                self._add_channel(mcap_records.Channel.read(_stream_of(content[begin:end])))

    def _add_schema(self, schema: mcap_records.Schema) -> None:
        self._limits.check_name(self._name, "a schema", schema.name)
        self.index.schemas[schema.id] = Schema(schema.id, schema.name, schema.encoding, schema.data)
        self._limits.check_channels(self._name, len(self.index.schemas))

    def _add_channel(self, channel: mcap_records.Channel) -> None:
        self._limits.check_name(self._name, "a topic", channel.topic)
        schema = self.index.schemas.get(channel.schema_id)
        self.index.channels[channel.id] = Channel(
            channel.id, channel.topic, channel.message_encoding, schema, channel.metadata
        )
        self._limits.check_channels(self._name, len(self.index.channels))


def _stream_of(data: bytes) -> ReadDataStream:
    return ReadDataStream(BytesIO(data))
