"""One MCAP file, whole or damaged, in the order of log time and in bounded memory."""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from mcap import records as mcap_records
from mcap.opcode import Opcode
from mcap.records import ChunkIndex

from logs.container.limits import ReadingLimits
from logs.errors import UnreadableLogError
from logs.storage.mcap_index import (
    DAMAGE,
    HEADER,
    MESSAGE_HEADER,
    McapIndex,
    read_block,
    records,
    stream_of,
)
from logs.storage.regular_file import open_regular
from logs.topics import Channel, RawMessage
from logs.validation import LAST_NS


@dataclass(frozen=True, slots=True)
class ChannelInfo:
    """A channel and its messages; the first and last log times are None where the file does not tell them."""

    channel: Channel
    message_count: int
    first_ns: int | None
    last_ns: int | None


class McapFile:
    """The MCAP file at ``path``.

    Messages come in the order of log time, those of equal time in the order of the file. A chunk is held in memory only
    while log time passes through it, so memory is that of the chunks that overlap in time; a chunk without messages of
    the wanted topics is not read where the index tells. A file without a usable index (cut off, not closed, unchunked)
    is walked through once when it is opened and then read the same way, as far as it is intact; damaged chunks are left
    out, and so is what is larger than ``limits`` allow.

    Raises:
        UnreadableLogError: it cannot be read, or is beyond the limits; ``name`` is what the message calls it.
    """

    def __init__(self, path: Path, name: str, limits: ReadingLimits) -> None:
        self._name = name
        self._limits = limits
        self._timeless_messages = 0
        try:
            self._stream = open_regular(path)
        except OSError as error:
            raise UnreadableLogError(f"cannot read {name}: {error.strerror}; check the path") from error
        try:
            self._index = McapIndex(name, self._stream, limits)
        except UnreadableLogError:
            self._stream.close()
            raise

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

    @property
    def counters(self) -> Mapping[str, int]:
        """``lost_chunks``, ``lost_bytes``, ``truncated`` (1: it ends before its end mark), ``chunks_too_large``; of the
        latest pass over messages ``messages_without_time``.
        """
        index = self._index
        return {
            "messages_without_time": self._timeless_messages,
            "lost_chunks": len(index.lost_blocks),
            "lost_bytes": index.lost_tail_bytes + sum(index.lost_blocks.values()),
            "truncated": int(not index.is_complete),
            "chunks_too_large": len(index.oversized),
        }

    def channels(self) -> list[ChannelInfo]:
        """The channels, and what is known of their messages."""
        counts = self._index.message_counts
        return [ChannelInfo(c, counts[c.id], *self._span(c.id)) for c in self._index.channels.values()]

    def _span(self, channel_id: int) -> tuple[int, int] | tuple[None, None]:
        """First and last log time of the blocks that may hold messages of a channel."""
        blocks = self._blocks_with({channel_id})
        if not blocks or not self._index.message_counts[channel_id]:
            return None, None
        return blocks[0].message_start_time, min(max(b.message_end_time for b in blocks), LAST_NS)

    def _blocks_with(self, channel_ids: Collection[int]) -> list[ChunkIndex]:
        """The blocks that may hold messages of any of these channels, by their first log time."""
        blocks = self._index.blocks
        return [b for b in blocks if not (there := b.message_index_offsets) or not there.keys().isdisjoint(channel_ids)]

    def messages(self, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
        """Undecoded messages of ``topics`` (None: of all), in the order of log time.

        Raises:
            UnreadableLogError: chunks overlap in time, and more than the limit waits in memory for its turn.
        """
        self._timeless_messages = 0
        wanted = {c.id: c for c in self._index.channels.values() if topics is None or c.topic in topics}
        waiting = self._blocks_with(wanted)[::-1]
        # (log time, offset of its block) is unique, so that messages are never compared; the next ones stand last.
        heap: list[tuple[int, int, list[RawMessage]]] = []
        held_bytes = Counter[int]()
        while waiting or heap:
            while waiting and (not heap or waiting[-1].message_start_time <= heap[0][0]):
                block = waiting.pop()
                messages = self._read(block, wanted)
                if messages:
                    held_bytes[block.chunk_start_offset] = sum(
                        # A message takes some 300 bytes besides its content.
                        len(message.data) + 300
                        for message in messages
                    )
                    heapq.heappush(heap, (messages[-1].log_time_ns, block.chunk_start_offset, messages))
                    self._check_held(held_bytes.total() if len(heap) > 1 else 0)
            if not heap:
                continue
            _, offset, messages = heap[0]
            message = messages.pop()
            if messages:
                heapq.heapreplace(heap, (messages[-1].log_time_ns, offset, messages))
            else:
                heapq.heappop(heap)
                del held_bytes[offset]
            yield message

    def metadata(self) -> dict[str, dict[str, str]]:
        """Metadata by name; of several under one name the last. What goes beyond the limits is left out."""
        found: dict[str, dict[str, str]] = {}
        left = round(1e6 * self._limits.metadata_mb)
        for offset in self._index.metadata_offsets:
            try:
                self._stream.seek(offset)
                _, length = HEADER.unpack(self._stream.read(HEADER.size))
                if length > left:
                    self._index.report("metadata", length)
                    continue
                record = mcap_records.Metadata.read(stream_of(self._stream.read(length)))
            except (*DAMAGE, OSError):
                self._index.lost_blocks[offset] = 0
                continue
            left -= length
            found[record.name] = record.metadata
        return found

    def _read(self, block: ChunkIndex, wanted: Mapping[int, Channel]) -> list[RawMessage]:
        """The messages of ``block`` on the channels ``wanted``, the latest first; none if it is damaged."""
        messages, timeless = list[RawMessage](), 0
        with self._index.noting_damage(block):
            content = read_block(self._stream, block, self._limits.chunk_bytes)
            for opcode, begin, end in records(content):
                if opcode != Opcode.MESSAGE:
                    continue
                id, sequence, log_time_ns, publish_time_ns = MESSAGE_HEADER.unpack_from(content, begin)
                if id in wanted and log_time_ns > LAST_NS:
                    timeless += 1
                elif id in wanted:
                    data = content[begin + MESSAGE_HEADER.size : end]
                    messages.append(RawMessage(wanted[id], log_time_ns, publish_time_ns, sequence, data))
            self._timeless_messages += timeless
            messages.reverse()
            messages.sort(key=lambda message: -message.log_time_ns)
            return messages
        return []

    def _check_held(self, held_bytes: int) -> None:
        if held_bytes > 1e6 * self._limits.waiting_mb:
            raise UnreadableLogError(
                f"{self._name}: chunks that overlap in time hold more than {self._limits.waiting_mb:g} MB of messages "
                "until they are read; write the log again in the order of time, or raise memory_mb"
            )
