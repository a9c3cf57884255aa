"""Reads a log: any MCAP file, whole or damaged, in the order of log time and in bounded memory."""

from __future__ import annotations

import heapq
import logging
import os
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import NamedTuple

from mcap import records as mcap_records

from logs import blocks
from logs.blocks import Block
from logs.container.file_index import DAMAGE, IndexedFile
from logs.container.limits import MEGABYTE, ReadingLimits
from logs.container.pending import PendingMessages
from logs.decoders.record_decoder import RecordDecoder
from logs.decoders.registry import kinds_of
from logs.digest import file_sha256
from logs.errors import UnreadableLogError
from logs.messages import Record
from logs.selection import Selection
from logs.topics import Channel, RawMessage, TopicInfo

_log = logging.getLogger(__name__)


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
    as it is intact; a damaged chunk is left out, and so is what is larger than ``limits`` allow. ``counters`` tells
    what was lost.

    Raises:
        UnreadableLogError: no file, a folder, no permission, an empty file, no MCAP, or one beyond the limits.
    """

    def __init__(self, path: str | os.PathLike[str], limits: ReadingLimits | None = None) -> None:
        self.path = Path(path)
        self._limits = limits or ReadingLimits()
        try:
            self._stream = open(self.path, "rb")  # noqa: SIM115  closed by close()
            size = os.fstat(self._stream.fileno()).st_size
            magic = self._stream.read(len(blocks.MAGIC))
        except OSError as error:
            raise UnreadableLogError(f"cannot read {self.path}: {error.strerror}; check the path") from error
        if magic != blocks.MAGIC:
            self._stream.close()
            what = "is no MCAP file (it does not begin with the MCAP signature)" if magic else "is empty"
            raise UnreadableLogError(f"{self.path} {what}; give a log that was recorded as MCAP")
        self._decoding_counters: Counter[str] = Counter()
        self._reading_counters: Counter[str] = Counter()
        self._told: set[str] = set()
        try:
            self._file = IndexedFile(str(self.path), self._stream, size, self._limits)
        except UnreadableLogError:
            self._stream.close()
            raise
        self._index = self._file.index
        self._tell_of_chunks()

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

        Of the file: ``lost_chunks``, ``lost_bytes``, ``truncated`` (1: it ends before its end mark) and
        ``chunks_too_large`` (by limits.chunk_mb). Of the latest pass over messages: ``messages_too_large`` (by
        limits.message_mb), ``messages_without_time`` (it is after the year 2116), and the counters of
        :class:`logs.decoders.record_decoder.RecordDecoder`.
        """
        counters = self._decoding_counters + self._reading_counters
        counters["lost_chunks"] = len(self._index.lost_blocks)
        counters["lost_bytes"] = self._index.lost_tail_bytes + sum(self._index.lost_blocks.values())
        counters["truncated"] = int(not self._index.is_complete)
        counters["chunks_too_large"] = len(self._index.oversized)
        return {name: count for name, count in sorted(counters.items()) if count}

    def topics(self) -> list[TopicInfo]:
        """What the log holds, by topic name; a topic with two schemas appears twice."""
        index = self._index
        groups: dict[tuple[str, str, str], list[Channel]] = {}
        for channel in index.channels.values():
            groups.setdefault((channel.topic, channel.schema_name, channel.message_encoding), []).append(channel)
        return [
            TopicInfo(
                topic=topic,
                schema_name=schema_name,
                encoding=encoding,
                message_count=sum(index.message_counts[c.id] for c in channels),
                kinds=kinds_of(channels[0]),
                first_log_time_ns=min((index.first_ns[c.id] for c in channels if c.id in index.first_ns), default=None),
                last_log_time_ns=max((index.last_ns[c.id] for c in channels if c.id in index.last_ns), default=None),
            )
            for (topic, schema_name, encoding), channels in sorted(groups.items())
        ]

    def messages(
        self, topics: Collection[str] | None = None, *, without_content: Collection[str] = ()
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

    def items(
        self, selection: Selection, copy: Collection[str] = (), times_of: Collection[str] = ()
    ) -> Iterator[LogItem]:
        """One pass over the selected topics, decoded, and the topics in ``copy``, raw; a topic may be in both.

        Messages of the topics in ``times_of`` that are neither come without their content. A message that no record
        may be made of is counted and comes without records.
        """
        decoder = RecordDecoder(selection, self._limits)
        self._decoding_counters = decoder.counters
        read = {*selection.topics, *copy}
        for raw in self.messages({*read, *times_of}, without_content=set(times_of) - read):
            yield LogItem(raw, decoder.records(raw))

    def records(self, selection: Selection) -> Iterator[LogEntry]:
        """One pass over the records of the selected topics; see :meth:`items`."""
        for item in self.items(selection):
            for record in item.records:
                yield LogEntry(item.raw.topic, item.raw.log_time_ns, record)

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

    def sha256(self) -> str:
        """Hexadecimal SHA-256 of the whole file."""
        return file_sha256(self.path)

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
                "%s: %s goes beyond %s = %g and is left out; more is only counted", self.path, what, limit, value
            )

    def _check_held(self, held_bytes: int) -> None:
        if held_bytes > self._limits.waiting_bytes:
            raise UnreadableLogError(
                f"{self.path}: chunks that overlap in time hold more than {self._limits.waiting_mb:g} MB of messages "
                "until their turn comes; write the log again in the order of time, or raise limits.waiting_mb"
            )
