"""One MCAP file, whole or damaged, in the order of log time and in bounded memory."""

from __future__ import annotations

import heapq
import logging
import os
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

from mcap import records as mcap_records

from logs.blocks import Block
from logs.container.file_index import DAMAGE, IndexedFile
from logs.container.limits import MEGABYTE, ReadingLimits
from logs.container.pending import PendingMessages
from logs.errors import UnreadableLogError
from logs.storage.regular_file import open_regular
from logs.storage.storage import ChannelInfo
from logs.topics import Channel, RawMessage

_log = logging.getLogger(__name__)


class McapFile:
    """The MCAP file at ``path``; see :class:`logs.storage.storage.Storage`.

    Messages come in the order of log time, those of equal time in the order of the file. A chunk is held in memory only
    while log time passes through it, so memory is that of the chunks that overlap in time; a chunk without messages of
    the wanted topics is not read where the index tells. A file without a usable
    index (cut off, not closed, unchunked) is walked through once when it is opened and then read the same way, as far
    as it is intact; a damaged chunk is left out, and so is what is larger than ``limits`` allow. ``counters`` tells
    what was lost.

    Raises:
        UnreadableLogError: it cannot be read, or is beyond the limits; ``name`` is what the message calls it.
    """

    def __init__(self, path: Path, name: str, limits: ReadingLimits) -> None:
        self._name = name
        self._limits = limits
        try:
            self._stream = open_regular(path)
            size = os.fstat(self._stream.fileno()).st_size
        except OSError as error:
            raise UnreadableLogError(f"cannot read {name}: {error.strerror}; check the path") from error
        self._reading_counters: Counter[str] = Counter()
        self._told: set[str] = set()
        try:
            self._file = IndexedFile(name, self._stream, size, self._limits)
        except UnreadableLogError:
            self._stream.close()
            raise
        self._index = self._file.index
        self._tell_of_chunks()

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

    @property
    def counters(self) -> Mapping[str, int]:
        """``lost_chunks``, ``lost_bytes``, ``truncated`` (1: it ends before its end mark), ``chunks_too_large``; of the
        latest pass over messages ``messages_too_large`` and ``messages_without_time``.
        """
        counters = Counter(self._reading_counters)
        counters["lost_chunks"] = len(self._index.lost_blocks)
        counters["lost_bytes"] = self._index.lost_tail_bytes + sum(self._index.lost_blocks.values())
        counters["truncated"] = int(not self._index.is_complete)
        counters["chunks_too_large"] = len(self._index.oversized)
        return counters

    def channels(self) -> list[ChannelInfo]:
        """The channels, and what is known of their messages."""
        index = self._index
        return [
            ChannelInfo(c, index.message_counts[c.id], index.first_ns.get(c.id), index.last_ns.get(c.id))
            for c in index.channels.values()
        ]

    def messages(
        self, topics: Collection[str] | None = None, without_content: Collection[str] = ()
    ) -> Iterator[RawMessage]:
        """Undecoded messages of ``topics`` (None: of all), in the order of log time.

        Those of the topics ``without_content`` come empty, for who only wants their times.

        Raises:
            UnreadableLogError: chunks overlap in time, and more than the limit waits in memory for its turn.
        """
        self._reading_counters.clear()
        wanted = {c.id: c for c in self._index.channels.values() if topics is None or c.topic in topics}
        empty = {id for id, channel in wanted.items() if channel.topic in without_content}
        waiting = [
            b for b in reversed(self._index.blocks) if b.channel_ids is None or not b.channel_ids.isdisjoint(wanted)
        ]
        # (log time, offset of its block) is unique, so that messages are never compared.
        heap: list[tuple[int, int, PendingMessages]] = []
        held_bytes = 0
        while waiting or heap:
            while waiting and (not heap or waiting[-1].start_ns <= heap[0][0]):
                block = waiting.pop()
                pending = self._pending(block, wanted, empty)
                if pending is not None:
                    held_bytes += pending.size_bytes
                    heapq.heappush(heap, (pending.next_ns, block.offset, pending))
                    if len(heap) > 1:
                        self._check_held(held_bytes)
            if not heap:
                continue
            _, offset, pending = heap[0]
            message = pending.take()
            if len(pending):
                heapq.heapreplace(heap, (pending.next_ns, offset, pending))
            else:
                heapq.heappop(heap)
                held_bytes -= pending.size_bytes
            yield message

    def metadata(self) -> dict[str, dict[str, str]]:
        """Metadata by name; of several under one name the last. What goes beyond limits.metadata_mb is left out."""
        found: dict[str, dict[str, str]] = {}
        left = self._limits.metadata_bytes
        for offset in self._index.metadata_offsets:
            length = self._file.length_at(offset)
            if length > left:
                self._tell(f"metadata of {length} bytes", "limits.metadata_mb", self._limits.metadata_mb)
                continue
            record = self._file.read_record(offset, mcap_records.Metadata.read, left)
            if record is not None:
                left -= length
                found[record.name] = record.metadata
        return found

    def _pending(self, block: Block, wanted: Mapping[int, Channel], empty: Collection[int]) -> PendingMessages | None:
        """The wanted messages of ``block``; None, counted, if it is damaged, or where there are none."""
        content = self._file.load(block)
        self._tell_of_chunks()
        if content is None:
            return None
        try:
            pending = PendingMessages(content, wanted, empty, self._limits.message_bytes)
        except DAMAGE:
            self._index.lost_blocks[block.offset] = block.length
            return None
        self._reading_counters["messages_without_time"] += pending.without_time
        if pending.oversized:
            self._reading_counters["messages_too_large"] += pending.oversized
            self._tell("a message", "limits.message_mb", self._limits.message_mb)
        return pending if len(pending) else None

    def _tell_of_chunks(self) -> None:
        for size in self._index.oversized.values():
            self._tell(f"a chunk of {size / MEGABYTE:.0f} MB", "limits.chunk_mb", self._limits.chunk_mb)

    def _tell(self, what: str, limit: str, value: float) -> None:
        """Warn once of what goes beyond a limit."""
        if limit not in self._told:
            self._told.add(limit)
            _log.warning(
                "%s: %s goes beyond %s = %g and is left out; more is only counted", self._name, what, limit, value
            )

    def _check_held(self, held_bytes: int) -> None:
        if held_bytes > self._limits.waiting_bytes:
            raise UnreadableLogError(
                f"{self._name}: chunks that overlap in time hold more than {self._limits.waiting_mb:g} MB of messages "
                "until their turn comes; write the log again in the order of time, or raise limits.waiting_mb"
            )
