"""What an MCAP file holds and where: from its summary, or, where that is missing or false, from a walk through it.

Damage anywhere costs no more than the block that it lies in: a chunk, or a run of records outside of chunks.
"""

import logging
import os
import struct
import zlib
from collections import Counter, defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from typing import Any, BinaryIO

import lz4.frame
import zstandard
from mcap import records as mcap_records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import ChunkIndex
from mcap.stream_reader import StreamReader

from logs.container.limits import ReadingLimits
from logs.errors import UnreadableLogError
from logs.topics import Channel, Schema
from logs.validation import LAST_NS

_log = logging.getLogger(__name__)

MAGIC = b"\x89MCAP0\r\n"
HEADER = struct.Struct("<BQ")  # opcode, length of what follows
MESSAGE_HEADER = struct.Struct("<HIQQ")  # channel id, sequence, log time, publish time
DAMAGE = (McapError, ValueError, RuntimeError, MemoryError, OverflowError, struct.error, EOFError, zstandard.ZstdError)
"""What decompressing or parsing damaged bytes may raise."""

Summary = dict[type, list[Any]]
"""The records of a summary by their type."""

_FOOTER = struct.Struct("<QQI")  # summary start, summary offset start, checksum of all from the summary start to here
_DEFINITIONS: dict[int, Any] = {Opcode.SCHEMA: mcap_records.Schema, Opcode.CHANNEL: mcap_records.Channel}


class OversizedChunkError(ValueError):
    """A chunk holds more than is allowed; ``size`` in bytes, decompressed."""

    def __init__(self, size: int) -> None:
        self.size = size


def read_summary(stream: BinaryIO) -> Summary | None:
    """The summary of a file, if it is there, whole, and has all that reading by it needs."""
    try:
        size = stream.seek(0, os.SEEK_END)
        stream.seek(max(size - len(MAGIC) - _FOOTER.size, 0))
        start, _, checksum = _FOOTER.unpack(stream.read(_FOOTER.size))
        # Parsed, 16 MB take some ten times as much.
        if not size - 16_000_000 <= start < size or start < len(MAGIC):
            return None
        stream.seek(start)
        content = stream.read()
        if checksum not in (0, zlib.crc32(content[: -len(MAGIC) - 4])):
            return None
        summary: Summary = defaultdict(list)
        for record in StreamReader(BytesIO(content), skip_magic=True).records:
            summary[type(record)].append(record)
    except (*DAMAGE, OSError):
        return None
    return summary if _is_enough(summary, size) else None


def _is_enough(summary: Summary, size: int) -> bool:
    chunks, channels = summary[ChunkIndex], summary[mcap_records.Channel]
    counted = next(iter(summary[mcap_records.Statistics]), None)
    return (
        counted is not None
        and (len(chunks) > 0 or counted.message_count == 0)
        and {channel.id for channel in channels} >= counted.channel_message_counts.keys()
        and {schema.id for schema in summary[mcap_records.Schema]} | {0} >= {channel.schema_id for channel in channels}
        and all(c.chunk_start_offset + c.chunk_length <= size for c in chunks)
        and len({c.chunk_start_offset for c in chunks}) == len(chunks)
        and len(summary[mcap_records.MetadataIndex]) == counted.metadata_count
        and len(summary[mcap_records.AttachmentIndex]) == counted.attachment_count
    )


def stream_of(data: bytes) -> ReadDataStream:
    """``data`` for the readers of records of the MCAP library."""
    return ReadDataStream(BytesIO(data))


def read_block(stream: BinaryIO, block: ChunkIndex, max_bytes: int) -> bytes:
    """The records of ``block``, decompressed into no more memory than the chunk says, and its checksum compared.

    Raises:
        OversizedChunkError: it says that it holds more than ``max_bytes``; nothing is decompressed then.
        OSError: the disk fails.
        DAMAGE: it is damaged, or holds another number of bytes than it says.
    """
    if block.chunk_length > max_bytes:
        raise OversizedChunkError(block.chunk_length)
    stream.seek(block.chunk_start_offset)
    head = stream.read(HEADER.size)
    opcode, length = HEADER.unpack(head)
    if opcode in _DEFINITIONS or opcode == Opcode.MESSAGE:
        return head + stream.read(max(block.chunk_length - HEADER.size, 0))
    if (opcode, length) != (Opcode.CHUNK, block.chunk_length - HEADER.size):
        raise ValueError(f"no chunk of {block.chunk_length} bytes at {block.chunk_start_offset}")
    chunk = mcap_records.Chunk.read(stream_of(stream.read(length)))
    if chunk.uncompressed_size > max_bytes:
        raise OversizedChunkError(chunk.uncompressed_size)
    data = decompress(chunk.data, chunk.compression, chunk.uncompressed_size)
    if len(data) != chunk.uncompressed_size or chunk.uncompressed_crc not in (0, zlib.crc32(data)):
        raise ValueError(f"size or checksum of the chunk at {block.chunk_start_offset}")
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


class McapIndex:
    """Channels, numbers of messages and places, from the summary of a file or from a walk through it.

    ``blocks``: chunks, or runs of records outside of chunks, by their first log time; the channels that may be in one
    are those in its ``message_index_offsets``, all if that is empty. ``lost_blocks``: offset -> bytes; ``oversized``:
    offsets of blocks that are too large; ``lost_tail_bytes``: at the end of the file, that are no records.

    Raises:
        UnreadableLogError: it holds more channels or blocks, or longer names, than the limits allow; ``name`` is what
            the message calls it.
    """

    def __init__(self, name: str, stream: BinaryIO, limits: ReadingLimits) -> None:
        self._name = name
        self._stream = stream
        self._limits = limits
        self._reported = set[str]()
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.message_counts = Counter[int]()
        self.blocks: list[ChunkIndex] = []
        self.metadata_offsets: list[int] = []
        self.is_complete = True
        self.lost_tail_bytes = 0
        self.lost_blocks: dict[int, int] = {}
        self.oversized: set[int] = set()
        summary = read_summary(stream)
        if summary is None:
            for start, end in self._walk():
                if end > start:
                    self._index(start, end)
        else:
            for definition in (*summary[mcap_records.Schema], *summary[mcap_records.Channel]):
                self._add(definition)
            self.message_counts.update(summary[mcap_records.Statistics][0].channel_message_counts)
            self.metadata_offsets = [each.offset for each in summary[mcap_records.MetadataIndex]]
            self.blocks = summary[ChunkIndex]
        self.blocks.sort(key=lambda block: (block.message_start_time, block.chunk_start_offset))

    @contextmanager
    def noting_damage(self, block: ChunkIndex) -> Iterator[None]:
        """Note that ``block`` is damaged or too large, if reading it says so, and leave it out.

        Raises:
            UnreadableLogError: the disk fails.
        """
        try:
            yield
        except OSError as error:
            raise UnreadableLogError(
                f"cannot continue to read {self._name}: {error.strerror}; check the disk"
            ) from error
        except OversizedChunkError as error:
            self._note_oversized(block.chunk_start_offset, error.size)
        except DAMAGE:
            self.lost_blocks[block.chunk_start_offset] = block.chunk_length

    def records_of(self, block: ChunkIndex) -> Iterator[tuple[int, bytes]]:
        """Opcode and content of each record in ``block``.

        Raises:
            OversizedChunkError: it is too large, and was not read.
            OSError: the disk fails.
            DAMAGE: it is damaged.
        """
        data = read_block(self._stream, block, self._limits.chunk_bytes)
        position = 0
        while position < len(data):
            opcode, length = HEADER.unpack_from(data, position)
            position += HEADER.size
            record = data[position : position + length]
            if len(record) < length:
                raise ValueError(f"record of {length} bytes at {position} of {len(data)}")
            position += length
            yield opcode, record

    def report(self, what: str, size: int) -> None:
        """Warn once of what goes beyond the limits."""
        if what not in self._reported:
            self._reported.add(what)
            text = "%s: %s of %.3g MB is more than memory_mb = %g allows and is left out; further ones are only counted"
            _log.warning(text, self._name, what, 1e-6 * size, self._limits.chunk_mb)

    def _note_oversized(self, offset: int, size: int) -> None:
        self.oversized.add(offset)
        self.report("a chunk", size)

    def _walk(self) -> Iterator[tuple[int, int]]:
        """Begin and end of each block, up to the end of the data or to where the records stop making sense."""
        self.is_complete = False
        size = self._stream.seek(0, os.SEEK_END)
        offset = run_start = len(MAGIC)
        while not self.is_complete:
            self._stream.seek(offset)
            head = self._stream.read(HEADER.size)
            if len(head) < HEADER.size:
                break
            opcode, length = HEADER.unpack(head)
            end = offset + HEADER.size + length
            if opcode == 0 or end > size:
                break
            is_of_run = opcode in (*_DEFINITIONS, Opcode.MESSAGE)
            is_in_run = is_of_run and length <= self._limits.message_bytes
            if not is_in_run or end - run_start > (1 << 20):
                yield run_start, end if is_in_run else offset
                run_start = end
            if opcode == Opcode.CHUNK:
                yield offset, end
            elif opcode == Opcode.METADATA:
                self.metadata_offsets.append(offset)
            elif is_of_run and not is_in_run:
                self._note_oversized(offset, end - offset)
            self.is_complete = opcode == Opcode.DATA_END
            offset = end
        yield run_start, offset
        self.lost_tail_bytes = 0 if self.is_complete else size - offset

    def _index(self, start: int, end: int) -> None:
        """Add a block with its channels and the numbers of its messages, unless it is damaged or too large."""
        if len(self.blocks) == 500_000:
            raise UnreadableLogError(
                f"{self._name} has more than {len(self.blocks)} chunks and no index; write it again with larger chunks"
            )
        block = ChunkIndex(
            chunk_start_offset=start,
            chunk_length=end - start,
            message_start_time=LAST_NS,
            message_end_time=0,
            message_index_offsets={},
            **dict.fromkeys(("compressed_size", "uncompressed_size", "message_index_length"), 0),
            compression="",
        )
        with self.noting_damage(block):
            for opcode, record in self.records_of(block):
                if opcode == Opcode.MESSAGE:
                    channel_id, _, log_time_ns, _ = MESSAGE_HEADER.unpack_from(record)
                    self.message_counts[channel_id] += 1
                    block.message_start_time = min(block.message_start_time, log_time_ns)
                    block.message_end_time = max(block.message_end_time, log_time_ns)
                elif opcode in _DEFINITIONS:
                    self._add(_DEFINITIONS[opcode].read(stream_of(record)))
            self.blocks.append(block)

    def _add(self, definition: mcap_records.Schema | mcap_records.Channel) -> None:
        if isinstance(definition, mcap_records.Schema):
            what, name = "a schema", definition.name
            self.schemas[definition.id] = Schema(definition.name, definition.encoding, definition.data)
        else:
            what, name = "a topic", definition.topic
            self.channels[definition.id] = Channel(
                definition.topic,
                definition.message_encoding,
                self.schemas.get(definition.schema_id),
                definition.metadata,
            )
        self._limits.check(self._name, len(name), f"characters in the name of {what}", self._limits.name_length)
        count = max(len(self.schemas), len(self.channels))
        self._limits.check(self._name, count, "channels or schemas", self._limits.channels)
