"""One MCAP file, whole or damaged, in the order of log time and in bounded memory."""

import heapq
from collections.abc import Collection, Iterator, Mapping
from itertools import zip_longest

from mcap import records as mcap_records
from mcap.opcode import Opcode
from mcap.records import ChunkIndex

from logs.errors import UnreadableLogError
from logs.storage.mcap_index import DAMAGE, HEADER, MESSAGE_HEADER, McapIndex, stream_of
from logs.topics import Channel, RawMessage
from logs.validation import LAST_NS


class McapFile(McapIndex):
    """An MCAP file.

    Messages come in the order of log time, those of equal time in the order of the file. A chunk is held in memory only
    while log time passes through it, so memory is that of the chunks that overlap in time; a chunk without messages of
    the wanted topics is not read where the index tells. A file without a usable index (cut off, not closed, unchunked)
    is walked through once when it is opened and then read the same way, as far as it is intact; damaged chunks are left
    out, and so is what is larger than ``limits`` allow.
    """

    _timeless_messages = 0

    @property
    def counters(self) -> Mapping[str, int]:
        """``lost_chunks``, ``lost_bytes``, ``truncated`` (1: it ends before its end mark), ``chunks_too_large``; of the
        latest pass over messages ``messages_without_time``.
        """
        return {
            "messages_without_time": self._timeless_messages,
            "lost_chunks": len(self.lost_blocks),
            "lost_bytes": self.lost_tail_bytes + sum(self.lost_blocks.values()),
            "truncated": int(not self.is_complete),
            "chunks_too_large": len(self.oversized),
        }

    def span_ns(self, channel_id: int) -> tuple[int, ...]:
        """First and last log time of the blocks that may hold messages of a channel; () where it has none."""
        blocks = self._blocks_with({channel_id})
        if not blocks or not self.message_counts[channel_id]:
            return ()
        return blocks[0].message_start_time, min(max(b.message_end_time for b in blocks), LAST_NS)

    def _blocks_with(self, channel_ids: Collection[int]) -> list[ChunkIndex]:
        """The blocks that may hold messages of any of these channels, by their first log time."""
        return [
            b for b in self.blocks if not (there := b.message_index_offsets) or not there.keys().isdisjoint(channel_ids)
        ]

    def messages(self, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
        """Undecoded messages of ``topics`` (None: of all), in the order of log time.

        Raises:
            UnreadableLogError: chunks overlap in time, and more than the limit waits in memory for its turn.
        """
        self._timeless_messages = 0
        wanted = {id: c for id, c in self.channels.items() if topics is None or c.topic in topics}
        blocks = self._blocks_with(wanted)
        # Of those of equal time the first in the file comes first; messages themselves are never compared.
        waiting: list[tuple[int, int, int, RawMessage]] = []
        waiting_bytes = 0
        for block, following in zip_longest(blocks, blocks[1:]):
            is_overlap = bool(waiting)
            for i, message in enumerate(self._read(block, wanted)):
                heapq.heappush(waiting, (message.log_time_ns, block.chunk_start_offset, i, message))
                waiting_bytes += _size_bytes(message)
            if is_overlap and waiting_bytes > self._limits.waiting_bytes:
                raise UnreadableLogError(
                    f"{self._name}: chunks that overlap in time hold more than "
                    f"{1e-6 * self._limits.waiting_bytes:g} MB of messages until they are read; write the log "
                    "again in the order of time, or raise memory_mb"
                )
            while waiting and (following is None or waiting[0][0] < following.message_start_time):
                *_, message = heapq.heappop(waiting)
                waiting_bytes -= _size_bytes(message)
                yield message

    def metadata(self) -> dict[str, dict[str, str]]:
        """Metadata by name; of several under one name the last. What goes beyond the limits is left out."""
        found = {}
        left = self._limits.metadata_bytes
        for offset in self.metadata_offsets:
            try:
                self._stream.seek(offset)
                _, length = HEADER.unpack(self._stream.read(HEADER.size))
                if length > left:
                    self.report("metadata", length)
                    continue
                record = mcap_records.Metadata.read(stream_of(self._stream.read(length)))
            except (*DAMAGE, OSError):
                self.lost_blocks[offset] = 0
                continue
            left -= length
            found[record.name] = record.metadata
        return found

    def _read(self, block: ChunkIndex, wanted: Mapping[int, Channel]) -> list[RawMessage]:
        """The messages of ``block`` on the channels ``wanted``, in the order of the file; none if it is damaged."""
        messages, timeless = list[RawMessage](), 0
        with self.noting_damage(block):
            for opcode, record in self.records_of(block):
                if opcode != Opcode.MESSAGE:
                    continue
                id, sequence, log_time_ns, publish_time_ns = MESSAGE_HEADER.unpack_from(record)
                if id in wanted and log_time_ns > LAST_NS:
                    timeless += 1
                elif id in wanted:
                    data = record[MESSAGE_HEADER.size :]
                    messages.append(RawMessage(wanted[id], log_time_ns, publish_time_ns, sequence, data))
            self._timeless_messages += timeless
            return messages
        return []


def _size_bytes(message: RawMessage) -> int:
    """What a message takes in memory: some 300 bytes besides its content."""
    return len(message.data) + 300
