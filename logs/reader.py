"""Reads a log: any MCAP file, whole or damaged, in the order of log time and in bounded memory."""

from __future__ import annotations

import heapq
import os
import struct
import zlib
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, TypeVar

import zstandard
from mcap import records as mcap_records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.reader import SeekingReader
from mcap.stream_reader import get_chunk_data_stream
from mcap.summary import Summary

from logs import blocks
from logs.blocks import Block
from logs.decoders.record_decoder import RecordDecoder
from logs.decoders.registry import kinds_of
from logs.digest import file_sha256
from logs.errors import UnreadableLogError
from logs.messages import Record
from logs.selection import Selection
from logs.topics import Channel, RawMessage, Schema, TopicInfo

# Whatever decompressing or parsing damaged bytes may raise.
_DAMAGE = (McapError, ValueError, RuntimeError, MemoryError, OverflowError, struct.error, EOFError, zstandard.ZstdError)

_Record = TypeVar("_Record")

_FOOTER = struct.Struct("<QQI")  # summary start, summary offset start, checksum of all from the summary start to here


class LogEntry(NamedTuple):
    """A record, the topic it was on and the time at which it was logged."""

    topic: str
    log_time_ns: int
    record: Record


@dataclass(frozen=True, slots=True, eq=False)
class LogItem:
    """One message as it stands in the file, and its records: () where its topic is only copied, or it is unfit."""

    raw: RawMessage
    records: tuple[Record, ...]


class LogReader:
    """Reads the log at ``path``; a context manager.

    Messages come in the order of log time, those of equal time in the order of the file. A chunk is held in memory only
    while log time passes through it, so memory is that of the chunks that overlap in time. A file without a usable
    index (cut off, not closed, unchunked) is walked through once when it is opened and then read the same way, as far
    as it is intact; a damaged chunk is left out. ``counters`` tells what was lost.

    Raises:
        UnreadableLogError: no file, a folder, no permission, an empty file or no MCAP.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        try:
            self._stream = open(self.path, "rb")  # noqa: SIM115  closed by close()
            self._size = os.fstat(self._stream.fileno()).st_size
            magic = self._stream.read(len(blocks.MAGIC))
        except OSError as error:
            raise UnreadableLogError(f"cannot read {self.path}: {error.strerror}; check the path") from error
        if magic != blocks.MAGIC:
            self._stream.close()
            what = "is no MCAP file (it does not begin with the MCAP signature)" if magic else "is empty"
            raise UnreadableLogError(f"{self.path} {what}; give a log that was recorded as MCAP")
        self._decoding_counters: Counter[str] = Counter()
        self._lost_blocks: dict[int, int] = {}  # offset -> bytes
        self._lost_tail_bytes = 0
        self._is_complete = True
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._message_counts: Counter[int] = Counter()
        self._first_ns: dict[int, int] = {}
        self._last_ns: dict[int, int] = {}
        self._blocks: list[Block] = []
        self._metadata_offsets: list[int] = []
        self._attachment_offsets: list[int] = []
        summary = self._usable_summary()
        if summary is None:
            self._index_by_walking()
        else:
            self._index_by_summary(summary)
        self._blocks.sort(key=lambda block: (block.start_ns, block.offset))

    def __enter__(self) -> LogReader:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

    @property
    def counters(self) -> dict[str, int]:
        """What was lost or left out so far; zeros are left out.

        Of the file: ``lost_chunks``, ``lost_bytes``, ``truncated`` (1: it ends before its end mark). Of the latest pass
        over records: the counters of :class:`logs.decoders.record_decoder.RecordDecoder`.
        """
        counters = Counter(self._decoding_counters)
        counters["lost_chunks"] = len(self._lost_blocks)
        counters["lost_bytes"] = self._lost_tail_bytes + sum(self._lost_blocks.values())
        counters["truncated"] = int(not self._is_complete)
        return {name: count for name, count in sorted(counters.items()) if count}

    def topics(self) -> list[TopicInfo]:
        """What the log holds, by topic name; a topic with two schemas appears twice."""
        groups: dict[tuple[str, str, str], list[Channel]] = {}
        for channel in self._channels.values():
            groups.setdefault((channel.topic, channel.schema_name, channel.message_encoding), []).append(channel)
        return [
            TopicInfo(
                topic=topic,
                schema_name=schema_name,
                encoding=encoding,
                message_count=sum(self._message_counts[c.id] for c in channels),
                kinds=kinds_of(channels[0]),
                first_log_time_ns=min((self._first_ns[c.id] for c in channels if c.id in self._first_ns), default=None),
                last_log_time_ns=max((self._last_ns[c.id] for c in channels if c.id in self._last_ns), default=None),
            )
            for (topic, schema_name, encoding), channels in sorted(groups.items())
        ]

    def messages(self, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
        """Undecoded messages of ``topics`` (None: of all), in the order of log time."""
        wanted = {c.id: c for c in self._channels.values() if topics is None or c.topic in topics}
        waiting = [b for b in reversed(self._blocks) if b.channel_ids is None or not b.channel_ids.isdisjoint(wanted)]
        # (log time, offset of its block, place in it) is unique, so that messages are never compared.
        heap: list[tuple[int, int, int, list[RawMessage]]] = []
        while waiting or heap:
            while waiting and (not heap or waiting[-1].start_ns <= heap[0][0]):
                block = waiting.pop()
                messages = self._messages_of(block, wanted)
                if messages:
                    heapq.heappush(heap, (messages[0].log_time_ns, block.offset, 0, messages))
            if not heap:
                continue
            _, offset, place, messages = heap[0]
            if place + 1 < len(messages):
                heapq.heapreplace(heap, (messages[place + 1].log_time_ns, offset, place + 1, messages))
            else:
                heapq.heappop(heap)
            yield messages[place]

    def items(self, selection: Selection, copy: Collection[str] = ()) -> Iterator[LogItem]:
        """One pass over the selected topics, decoded, and the topics in ``copy``, raw; a topic may be in both.

        A message that no record may be made of is counted and comes without records.
        """
        decoder = RecordDecoder(selection)
        self._decoding_counters = decoder.counters
        for raw in self.messages({*selection.topics, *copy}):
            yield LogItem(raw, decoder.records(raw))

    def records(self, selection: Selection) -> Iterator[LogEntry]:
        """One pass over the records of the selected topics; see :meth:`items`."""
        for item in self.items(selection):
            for record in item.records:
                yield LogEntry(item.raw.topic, item.raw.log_time_ns, record)

    def metadata(self) -> dict[str, dict[str, str]]:
        """Metadata by name; of several under one name the last."""
        found: dict[str, dict[str, str]] = {}
        for record in self._records_at(self._metadata_offsets, mcap_records.Metadata.read):
            found[record.name] = record.metadata
        return found

    def attachments(self) -> dict[str, bytes]:
        """Attachments by name; of several under one name the last."""
        found: dict[str, bytes] = {}
        for record in self._records_at(self._attachment_offsets, mcap_records.Attachment.read):
            found[record.name] = record.data
        return found

    def sha256(self) -> str:
        """Hexadecimal SHA-256 of the whole file."""
        return file_sha256(self.path)

    def _usable_summary(self) -> Summary | None:
        """The summary of the file, if it is there, whole, and tells all that reading by it needs."""
        try:
            self._stream.seek(0)
            summary = SeekingReader(self._stream).get_summary()
            self._stream.seek(self._size - len(blocks.MAGIC) - _FOOTER.size)
            summary_start, _, checksum = _FOOTER.unpack(self._stream.read(_FOOTER.size))
            self._stream.seek(summary_start)
            covered = self._stream.read(self._size - len(blocks.MAGIC) - 4 - summary_start)
        except (*_DAMAGE, OSError):
            return None
        if summary is None or summary.statistics is None or checksum not in (0, zlib.crc32(covered)):
            return None
        statistics = summary.statistics
        is_enough = (
            len(summary.chunk_indexes) > 0
            and all(id in summary.channels for id in statistics.channel_message_counts)
            and all(c.schema_id == 0 or c.schema_id in summary.schemas for c in summary.channels.values())
            and all(c.chunk_start_offset + c.chunk_length <= self._size for c in summary.chunk_indexes)
            and len(summary.metadata_indexes) == statistics.metadata_count
            and len(summary.attachment_indexes) == statistics.attachment_count
        )
        return summary if is_enough else None

    def _index_by_summary(self, summary: Summary) -> None:
        for schema in summary.schemas.values():
            self._add_schema(schema)
        for channel in summary.channels.values():
            self._add_channel(channel)
        if summary.statistics is not None:
            self._message_counts.update(summary.statistics.channel_message_counts)
        self._metadata_offsets = [index.offset for index in summary.metadata_indexes]
        self._attachment_offsets = [index.offset for index in summary.attachment_indexes]
        for c in summary.chunk_indexes:
            start_ns, end_ns = c.message_start_time, c.message_end_time
            ids = frozenset(c.message_index_offsets) or None
            self._blocks.append(Block(c.chunk_start_offset, c.chunk_length, start_ns, end_ns, True, ids))
        try:
            self._read_time_spans(summary.chunk_indexes)
        except (*_DAMAGE, OSError):
            self._first_ns, self._last_ns = {}, {}  # the times are only for show

    def _read_time_spans(self, chunks: list[mcap_records.ChunkIndex]) -> None:
        """First and last log time of each channel, from the message indexes of the few chunks that can hold them."""
        for chunk in sorted(chunks, key=lambda c: c.message_start_time):
            for id, offset in chunk.message_index_offsets.items():
                if id not in self._first_ns or chunk.message_start_time < self._first_ns[id]:
                    first_ns = min(time for time, _ in mcap_records.MessageIndex.read(self._content_at(offset)).records)
                    self._first_ns[id] = min(first_ns, self._first_ns.get(id, first_ns))
        for chunk in sorted(chunks, key=lambda c: -c.message_end_time):
            for id, offset in chunk.message_index_offsets.items():
                if id not in self._last_ns or chunk.message_end_time > self._last_ns[id]:
                    last_ns = max(time for time, _ in mcap_records.MessageIndex.read(self._content_at(offset)).records)
                    self._last_ns[id] = max(last_ns, self._last_ns.get(id, last_ns))

    def _index_by_walking(self) -> None:
        found = blocks.walk(self._stream, self._size)
        self._is_complete = found.is_complete
        self._lost_tail_bytes = found.lost_bytes
        self._metadata_offsets = found.metadata_offsets
        self._attachment_offsets = found.attachment_offsets
        for block in found.blocks:
            loaded = self._load(block)
            if loaded is None:
                continue
            try:
                self._index_content(*loaded)
            except _DAMAGE:
                self._lost_blocks[block.offset] = block.length
            else:
                self._blocks.append(block)

    def _index_content(self, data: bytes, records: list[tuple[int, int, int]]) -> None:
        for opcode, begin, end in records:
            if opcode == blocks.MESSAGE:
                id, _, log_time_ns, _ = blocks.MESSAGE_HEADER.unpack_from(data, begin)
                self._message_counts[id] += 1
                self._first_ns[id] = min(log_time_ns, self._first_ns.get(id, log_time_ns))
                self._last_ns[id] = max(log_time_ns, self._last_ns.get(id, log_time_ns))
            elif opcode == blocks.SCHEMA:
                self._add_schema(mcap_records.Schema.read(_stream_of(data[begin:end])))
            elif opcode == blocks.CHANNEL:
                self._add_channel(mcap_records.Channel.read(_stream_of(data[begin:end])))

    def _add_schema(self, schema: mcap_records.Schema) -> None:
        self._schemas[schema.id] = Schema(schema.id, schema.name, schema.encoding, schema.data)

    def _add_channel(self, channel: mcap_records.Channel) -> None:
        schema = self._schemas.get(channel.schema_id)
        self._channels[channel.id] = Channel(
            channel.id, channel.topic, channel.message_encoding, schema, channel.metadata
        )

    def _load(self, block: Block) -> tuple[bytes, list[tuple[int, int, int]]] | None:
        """The bytes of ``block``, decompressed and checked, and its (opcode, begin, end); None, counted, if damaged."""
        try:
            self._stream.seek(block.offset)
            data = self._stream.read(block.length)
            if block.is_chunk:
                chunk = mcap_records.Chunk.read(_stream_of(data[blocks.HEADER.size :]))
                stream, size = get_chunk_data_stream(chunk, validate_crc=True)
                data = stream.read(size)
            return data, list(blocks.records(data))
        except OSError as error:
            raise UnreadableLogError(f"cannot read on in {self.path}: {error.strerror}; check the disk") from error
        except _DAMAGE:
            self._lost_blocks[block.offset] = block.length
            return None

    def _messages_of(self, block: Block, wanted: Mapping[int, Channel]) -> list[RawMessage]:
        loaded = self._load(block)
        if loaded is None:
            return []
        data, records = loaded
        messages = []
        for opcode, begin, end in records:
            if opcode == blocks.MESSAGE:
                id, sequence, log_time_ns, publish_time_ns = blocks.MESSAGE_HEADER.unpack_from(data, begin)
                channel = wanted.get(id)
                if channel is not None:
                    content = data[begin + blocks.MESSAGE_HEADER.size : end]
                    messages.append(RawMessage(channel, log_time_ns, publish_time_ns, sequence, content))
        messages.sort(key=lambda message: message.log_time_ns)
        return messages

    def _records_at(self, offsets: list[int], read: Callable[[ReadDataStream], _Record]) -> Iterator[_Record]:
        for offset in offsets:
            try:
                yield read(self._content_at(offset))
            except _DAMAGE:
                self._lost_blocks[offset] = 0

    def _content_at(self, offset: int) -> ReadDataStream:
        self._stream.seek(offset)
        _, length = blocks.HEADER.unpack(self._stream.read(blocks.HEADER.size))
        return _stream_of(self._stream.read(length))


def _stream_of(data: bytes) -> ReadDataStream:
    return ReadDataStream(BytesIO(data))
