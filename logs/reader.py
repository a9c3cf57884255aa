"""Reads a log: an MCAP file or a rosbag2 folder, in the order of log time and in bounded memory."""

import hashlib
import heapq
from collections import Counter, defaultdict
from collections.abc import Collection, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

from logs.container.limits import ReadingLimits
from logs.decoders.decode import RecordDecoder, kinds_of
from logs.digest import file_sha256
from logs.messages import Record
from logs.records import frozen
from logs.selection import Selection
from logs.storage.mcap_file import McapFile
from logs.storage.opening import find_bag_files, open_file
from logs.storage.regular_file import AnyPath
from logs.topics import RawMessage, RecordKind, TopicInfo

_TopicKey = tuple[str, str, str]
"""Topic, name of the schema and encoding of the messages."""


class LogEntry(NamedTuple):
    """A record, the topic it was on and the time at which it was logged."""

    topic: str
    log_time_ns: int
    record: Record


@frozen
class LogItem:
    """One message as it stands in the file, and its records: () where its topic is only copied, or it is unfit."""

    raw: RawMessage
    records: tuple[Record, ...]


class LogReader:
    """Reads the log at ``path``; a context manager.

    The log is an MCAP file, or the folder of a rosbag2 recording with any number of them.
    Messages come in the order of log time, those of equal time in the order of the file. What is damaged, or larger
    than ``limits`` allow, is left out; ``counters`` tells what.

    Raises:
        UnreadableLogError: no file, no permission, an empty file, no log, one beyond the limits, or a folder that is no
            whole recording.
    """

    def __init__(self, path: AnyPath, limits: ReadingLimits | None = None) -> None:
        self.path = Path(path)
        limits = limits or ReadingLimits()
        self.files = find_bag_files(self.path) if self.path.is_dir() else [self.path]
        self.decoding_counters: Counter[str] = Counter()
        """What was left out by the latest pass over records alone."""
        self._decoder = RecordDecoder(limits)
        with ExitStack() as until_closed:
            self._open: list[McapFile] = [open_file(file, limits, until_closed) for file in self.files]
            self._until_closed = until_closed.pop_all()

    def __enter__(self) -> "LogReader":
        return self

    def __exit__(self, *error: object) -> None:
        self._until_closed.close()

    @property
    def counters(self) -> dict[str, int]:
        """What was lost or left out so far; zeros are left out.

        Of the files: ``lost_chunks``, ``lost_bytes``, ``truncated`` (those that end before their end mark) and
        ``chunks_too_large`` (by the setting ``memory_mb``). Of the latest pass over messages: ``messages_without_time``
        (it is after the year 2116), and the counters of :class:`logs.decoders.decode.RecordDecoder`.
        """
        counters = Counter(self.decoding_counters)
        for file in self._open:
            counters.update(file.counters)
        return dict(sorted((+counters).items()))

    @property
    def size_bytes(self) -> int:
        """Size of all files as they are stored."""
        return sum(file.stat().st_size for file in self.files)

    def topics(self) -> list[TopicInfo]:
        """What the log holds, by topic name; a topic with two schemas appears twice."""
        counts, kinds = Counter[_TopicKey](), dict[_TopicKey, tuple[RecordKind, ...]]()
        times_ns = defaultdict[_TopicKey, list[int]](list)
        for file in self._open:
            for id, channel in file.channels.items():
                key = channel.topic, channel.schema_name, channel.message_encoding
                counts[key] += file.message_counts[id]
                times_ns[key] += file.span_ns(id)
                kinds.setdefault(key, kinds_of(channel))
        return [
            TopicInfo(*key, counts[key], kinds[key], min(times, default=None), max(times, default=None))
            for key, times in sorted(times_ns.items())
        ]

    def messages(self, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
        """Undecoded messages of ``topics`` (None: of all), in the order of log time.

        Raises:
            UnreadableLogError: chunks overlap in time, and more than the limit waits in memory for its turn.
        """
        streams = (file.messages(topics) for file in self._open)
        return heapq.merge(*streams, key=lambda message: message.log_time_ns)

    def items(self, selection: Selection, copy: Collection[str] = ()) -> Iterator[LogItem]:
        """One pass over the selected topics, decoded, and the topics in ``copy``, raw; a topic may be in both.

        A message that no record may be made of is counted and comes without records.
        """
        self.decoding_counters = self._decoder.counters = Counter()
        for raw in self.messages({*selection.topics, *copy}):
            kinds = selection.kinds.get(raw.topic, ())
            yield LogItem(raw, self._decoder.records(raw, kinds, selection.mappings.get(raw.topic)) if kinds else ())

    def records(self, selection: Selection) -> Iterator[LogEntry]:
        """One pass over the records of the selected topics; see :meth:`items`."""
        for item in self.items(selection):
            for record in item.records:
                yield LogEntry(item.raw.topic, item.raw.log_time_ns, record)

    def metadata(self) -> dict[str, dict[str, str]]:
        """Metadata by name; of several under one name the last."""
        return {name: values for file in self._open for name, values in file.metadata().items()}

    def sha256(self) -> str:
        """Hexadecimal SHA-256 of the file; of a folder, of those of its files, one after another."""
        digests = [file_sha256(file) for file in self.files]
        return digests[0] if not self.path.is_dir() else hashlib.sha256("".join(digests).encode()).hexdigest()
