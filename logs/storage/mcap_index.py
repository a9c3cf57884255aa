"""What an MCAP file holds and where: from its summary, or, where that is missing or false, from a walk through it.

Damage anywhere costs no more than the block that it lies in: a chunk, or a run of records outside of chunks.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from typing import Any, BinaryIO

import lz4.frame
import zstandard
from mcap import records as mcap_records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode

from logs.container.limits import ReadingLimits
from logs.errors import UnreadableLogError
from logs.topics import Channel, Schema

MAGIC = b"\x89MCAP0\r\n"
HEADER = struct.Struct("<BQ")  # opcode, length of what follows
MESSAGE_HEADER = struct.Struct("<HIQQ")  # channel id, sequence, log time, publish time
DAMAGE = (McapError, ValueError, RuntimeError, MemoryError, OverflowError, struct.error, EOFError, zstandard.ZstdError)
"""What decompressing or parsing damaged bytes may raise."""

_CHUNK_TIMES = struct.Struct("<QQ")  # first and last log time
_FOOTER = struct.Struct("<QQI")  # summary start, summary offset start, checksum of all from the summary start to here
_RUN_BYTES = 1 << 20  # records outside of chunks are read in runs of about this size
_MAX_SUMMARY_BYTES = 16_000_000  # parsed it takes some ten times that
_MAX_BLOCKS = 500_000
_OUTSIDE_OF_CHUNKS = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE)
_SUMMARY_RECORDS: dict[int, Any] = {
    Opcode.SCHEMA: mcap_records.Schema,
    Opcode.CHANNEL: mcap_records.Channel,
    Opcode.STATISTICS: mcap_records.Statistics,
    Opcode.CHUNK_INDEX: mcap_records.ChunkIndex,
    Opcode.ATTACHMENT_INDEX: mcap_records.AttachmentIndex,
    Opcode.METADATA_INDEX: mcap_records.MetadataIndex,
    Opcode.SUMMARY_OFFSET: mcap_records.SummaryOffset,
    Opcode.FOOTER: mcap_records.Footer,
}


class OversizedChunkError(ValueError):
    """A chunk holds more than is allowed; ``size`` in bytes, decompressed."""

    def __init__(self, size: int) -> None:
        super().__init__(f"{size} bytes")
        self.size = size


@dataclass(frozen=True, slots=True)
class Block:
    """Bytes [offset, offset + length) of the file, with messages of log times [start_ns, end_ns], both included.

    ``channel_ids`` are those that may be in it, None where the file does not say.
    """

    offset: int
    length: int
    start_ns: int
    end_ns: int
    is_chunk: bool
    channel_ids: frozenset[int] | None = None


@dataclass(slots=True)
class McapIndex:
    """Channels, numbers of messages and places; ``blocks`` by their first log time.

    ``lost_blocks``: offset -> bytes; ``oversized``: offset -> bytes, decompressed; ``lost_tail_bytes``: at the end of
    the file, that are no records. ``attachments``: None without a usable summary.
    """

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    message_counts: Counter[int] = field(default_factory=Counter)
    blocks: list[Block] = field(default_factory=list)
    metadata_offsets: list[int] = field(default_factory=list)
    attachments: list[mcap_records.AttachmentIndex] | None = None
    is_complete: bool = True
    lost_tail_bytes: int = 0
    lost_blocks: dict[int, int] = field(default_factory=dict)
    oversized: dict[int, int] = field(default_factory=dict)


def read_index(name: str, stream: BinaryIO, size: int, limits: ReadingLimits) -> McapIndex:
    """The index of an MCAP file of ``size`` bytes; ``name`` is what messages call it.

    Raises:
        UnreadableLogError: it holds more channels or blocks, or longer names, than the limits allow.
    """
    return _Indexing(name, stream, size, limits).run()


def records(data: bytes) -> Iterator[tuple[int, int, int]]:
    """(opcode, begin, end) of the content of each record in ``data``.

    Raises:
        ValueError: a record reaches beyond the end of the data.
    """
    position, size = 0, len(data)
    while position < size:
        if position + HEADER.size > size:
            raise ValueError(f"{size - position} stray bytes after the last record")
        opcode, length = HEADER.unpack_from(data, position)
        position += HEADER.size
        end = position + length
        if end > size or (opcode == Opcode.MESSAGE and length < MESSAGE_HEADER.size):
            raise ValueError(f"record of {length} bytes does not fit at {position} of {size}")
        yield opcode, position, end
        position = end


def stream_of(data: bytes) -> ReadDataStream:
    """``data`` for the readers of records of the MCAP library."""
    return ReadDataStream(BytesIO(data))


def read_block(stream: BinaryIO, block: Block, max_bytes: int) -> bytes:
    """The records of ``block``, decompressed into no more memory than the chunk says, and its checksum compared.

    Raises:
        OversizedChunkError: it says that it holds more than ``max_bytes``; nothing is decompressed then.
        OSError: the disk fails.
        DAMAGE: it is damaged, or holds another number of bytes than it says.
    """
    stream.seek(block.offset)
    if not block.is_chunk:
        return stream.read(block.length)
    if block.length > max_bytes:
        raise OversizedChunkError(block.length)
    if HEADER.unpack(stream.read(HEADER.size)) != (Opcode.CHUNK, block.length - HEADER.size):
        raise ValueError(f"no chunk of {block.length} bytes at {block.offset}")
    chunk = mcap_records.Chunk.read(stream_of(stream.read(block.length - HEADER.size)))
    if chunk.uncompressed_size > max_bytes:
        raise OversizedChunkError(chunk.uncompressed_size)
    data = decompress(chunk.data, chunk.compression, chunk.uncompressed_size)
    if len(data) != chunk.uncompressed_size or chunk.uncompressed_crc not in (0, zlib.crc32(data)):
        raise ValueError(f"size or checksum of the chunk at {block.offset}")
    return data


def decompress(data: bytes, compression: str, size: int) -> bytes:
    """At most ``size`` + 1 bytes of what ``data`` unpacks to: the library unpacks as much as its frames ask for.

    Raises:
        ValueError: the compression is not known, or its frame says another size.
    """
    if compression == "zstd":
        promised = zstandard.get_frame_parameters(data).content_size
        if promised not in (size, zstandard.CONTENTSIZE_UNKNOWN):
            raise ValueError(f"a frame of {promised} bytes in a chunk of {size}")
        return zstandard.ZstdDecompressor().decompress(data, max_output_size=max(size, 1))
    if compression == "lz4":
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1))
    if compression:
        raise ValueError(f"unknown compression {compression!r}")
    return data


class _Indexing:
    def __init__(self, name: str, stream: BinaryIO, size: int, limits: ReadingLimits) -> None:
        self._name = name
        self._stream = stream
        self._size = size
        self._limits = limits
        self._index = McapIndex()

    def run(self) -> McapIndex:
        summary = self._read_summary()
        if summary is None:
            self._walk()
            self._index.blocks = [block for block in self._index.blocks if self._is_indexed(block)]
        else:
            self._take_summary(summary)
        self._index.blocks.sort(key=lambda block: (block.start_ns, block.offset))
        return self._index

    def _read_summary(self) -> dict[int, list[Any]] | None:
        """The records of the summary by opcode, if it is there, whole, and has all that reading by it needs."""
        try:
            self._stream.seek(max(self._size - len(MAGIC) - _FOOTER.size, 0))
            start, _, checksum = _FOOTER.unpack(self._stream.read(_FOOTER.size))
            length = self._size - len(MAGIC) - start
            if not 0 < length <= _MAX_SUMMARY_BYTES or start < len(MAGIC):
                return None
            self._stream.seek(start)
            content = self._stream.read(length)
            if checksum not in (0, zlib.crc32(content[:-4])):
                return None
            opcodes = Counter(opcode for opcode, _, _ in records(content))
            self._limits.check_channels(self._name, max(opcodes[Opcode.SCHEMA], opcodes[Opcode.CHANNEL]))
            summary: dict[int, list[Any]] = defaultdict(list)
            for opcode, begin, end in records(content):
                summary[opcode].append(_SUMMARY_RECORDS[opcode].read(stream_of(content[begin:end])))
        except (*DAMAGE, OSError, KeyError):
            return None
        return summary if self._is_enough(summary) else None

    def _is_enough(self, summary: dict[int, list[Any]]) -> bool:
        chunks, channels = summary[Opcode.CHUNK_INDEX], summary[Opcode.CHANNEL]
        counted = next(iter(summary[Opcode.STATISTICS]), None)
        return (
            counted is not None
            and (len(chunks) > 0 or counted.message_count == 0)
            and {channel.id for channel in channels} >= counted.channel_message_counts.keys()
            and {schema.id for schema in summary[Opcode.SCHEMA]} | {0} >= {channel.schema_id for channel in channels}
            and all(c.chunk_start_offset + c.chunk_length <= self._size for c in chunks)
            and len({c.chunk_start_offset for c in chunks}) == len(chunks)
            and len(summary[Opcode.METADATA_INDEX]) == counted.metadata_count
            and len(summary[Opcode.ATTACHMENT_INDEX]) == counted.attachment_count
        )

    def _take_summary(self, summary: dict[int, list[Any]]) -> None:
        for definition in (*summary[Opcode.SCHEMA], *summary[Opcode.CHANNEL]):
            self._add(definition)
        index = self._index
        index.message_counts.update(summary[Opcode.STATISTICS][0].channel_message_counts)
        index.metadata_offsets = [each.offset for each in summary[Opcode.METADATA_INDEX]]
        index.attachments = summary[Opcode.ATTACHMENT_INDEX]
        shared: dict[frozenset[int], frozenset[int]] = {}  # most chunks hold the same channels
        for c in summary[Opcode.CHUNK_INDEX]:
            ids = frozenset(c.message_index_offsets)
            ids = shared.setdefault(ids, ids)
            place = c.chunk_start_offset, c.chunk_length, c.message_start_time, c.message_end_time
            index.blocks.append(Block(*place, is_chunk=True, channel_ids=ids or None))

    def _walk(self) -> None:
        """Find the blocks up to the end of the data, or to where the records stop making sense."""
        index = self._index
        index.is_complete = False
        offset = run_start = len(MAGIC)
        run_times: list[int] = []
        while not index.is_complete:
            self._stream.seek(offset)
            head = self._stream.read(HEADER.size + MESSAGE_HEADER.size)
            if len(head) < HEADER.size:
                break
            opcode, length = HEADER.unpack_from(head)
            end = offset + HEADER.size + length
            if opcode == 0 or end > self._size:
                break
            is_in_run = opcode in _OUTSIDE_OF_CHUNKS and length <= self._limits.message_bytes
            if is_in_run and opcode == Opcode.MESSAGE and length >= MESSAGE_HEADER.size:
                run_times.append(MESSAGE_HEADER.unpack_from(head, HEADER.size)[2])
            if not is_in_run or end - run_start > _RUN_BYTES:
                self._add_run(run_start, end if is_in_run else offset, run_times)
                run_start = end
            if not is_in_run:
                self._add_place(opcode, offset, end, head)
            offset = end
        self._add_run(run_start, offset, run_times)
        index.lost_tail_bytes = 0 if index.is_complete else self._size - offset
        if len(index.blocks) > _MAX_BLOCKS:
            raise UnreadableLogError(
                f"{self._name} has {len(index.blocks)} chunks and no index; write it again with larger chunks"
            )

    def _add_run(self, start: int, end: int, times_ns: list[int]) -> None:
        if end > start:
            first_ns, last_ns = min(times_ns, default=0), max(times_ns, default=0)
            self._index.blocks.append(Block(start, end - start, first_ns, last_ns, is_chunk=False))
        times_ns.clear()

    def _add_place(self, opcode: int, offset: int, end: int, head: bytes) -> None:
        if opcode == Opcode.CHUNK and len(head) >= HEADER.size + _CHUNK_TIMES.size:
            start_ns, end_ns = _CHUNK_TIMES.unpack_from(head, HEADER.size)
            self._index.blocks.append(Block(offset, end - offset, start_ns, end_ns, is_chunk=True))
        elif opcode == Opcode.METADATA:
            self._index.metadata_offsets.append(offset)
        elif opcode in _OUTSIDE_OF_CHUNKS:
            self._index.oversized[offset] = end - offset
        self._index.is_complete = opcode == Opcode.DATA_END

    def _is_indexed(self, block: Block) -> bool:
        """Add the channels and the numbers of messages of ``block``, unless it is damaged or too large."""
        index = self._index
        try:
            content = read_block(self._stream, block, self._limits.chunk_bytes)
            for opcode, begin, end in records(content):
                if opcode == Opcode.MESSAGE:
                    index.message_counts[MESSAGE_HEADER.unpack_from(content, begin)[0]] += 1
                elif opcode in _OUTSIDE_OF_CHUNKS:
                    self._add(_SUMMARY_RECORDS[opcode].read(stream_of(content[begin:end])))
            return True
        except OSError as error:
            raise UnreadableLogError(
                f"cannot continue to read {self._name}: {error.strerror}; check the disk"
            ) from error
        except OversizedChunkError as error:
            index.oversized[block.offset] = error.size
        except DAMAGE:
            index.lost_blocks[block.offset] = block.length
        return False

    def _add(self, definition: mcap_records.Schema | mcap_records.Channel) -> None:
        index, limits = self._index, self._limits
        if isinstance(definition, mcap_records.Schema):
            limits.check_name(self._name, "a schema", definition.name)
            is_ros1 = definition.encoding == "ros1msg"  # its names lack the folder that those of ROS 2 have
            name = definition.name.replace("/", "/msg/") if is_ros1 else definition.name
            schema = Schema(definition.id, name, definition.encoding, definition.data)
            index.schemas[definition.id] = schema
        else:
            limits.check_name(self._name, "a topic", definition.topic)
            index.channels[definition.id] = Channel(
                definition.id,
                definition.topic,
                definition.message_encoding,
                index.schemas.get(definition.schema_id),
                definition.metadata,
            )
        limits.check_channels(self._name, max(len(index.schemas), len(index.channels)))
