"""One bag of ROS 1 (.bag)."""

from __future__ import annotations

import bz2
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

import lz4.frame
from rosbags.interfaces import Connection
from rosbags.rosbag1 import Reader, ReaderError

from logs.container.limits import ReadingLimits
from logs.errors import UnreadableLogError
from logs.storage.mcap_index import DAMAGE
from logs.storage.storage import ChannelInfo
from logs.topics import Channel, RawMessage, Schema

_DAMAGE = (*DAMAGE, ReaderError, AssertionError, LookupError)


class Ros1File:
    """The bag at ``path``; see :class:`logs.storage.storage.Storage`.

    Messages come in the order of log time, in the encoding "ros1", up to the first damaged chunk.

    Raises:
        UnreadableLogError: the bag is damaged or was not closed; ``name`` is what the message calls it.
    """

    def __init__(self, path: Path, name: str, limits: ReadingLimits) -> None:
        self._limits = limits
        self._is_complete = True
        self._reading_counters: Counter[str] = Counter()
        self._reader = Reader(path)
        try:
            self._reader.open()
        except (*_DAMAGE, OSError) as error:
            raise UnreadableLogError(f"cannot read {name}: {error}; 'rosbag reindex' repairs a damaged bag") from error
        try:
            limits.check_channels(name, len(self._reader.connections))
            for connection in self._reader.connections:
                limits.check_name(name, "a topic", connection.topic)
                limits.check_name(name, "a type", connection.msgtype)
        except UnreadableLogError:
            self._reader.close()
            raise
        self._channels = {connection.id: _channel(connection) for connection in self._reader.connections}
        for offset, chunk in self._reader.chunks.items():
            self._reader.chunks[offset] = chunk._replace(decompressor=self._decompress)

    @property
    def counters(self) -> Mapping[str, int]:
        """``truncated`` (1: it could not be read to its end); of the latest pass ``messages_too_large``."""
        return {**self._reading_counters, "truncated": int(not self._is_complete)}

    def channels(self) -> list[ChannelInfo]:
        """The channels, with their numbers of messages and the times of the bag."""
        span = self._reader.start_time, self._reader.end_time
        return [
            ChannelInfo(self._channels[c.id], c.msgcount, *(span if c.msgcount else (None, None)))
            for c in self._reader.connections
        ]

    def messages(
        self, topics: Collection[str] | None = None, without_content: Collection[str] = ()
    ) -> Iterator[RawMessage]:
        """Undecoded messages of ``topics`` (None: of all), in the order of log time; some of them without content."""
        self._reading_counters.clear()
        wanted = [c for c in self._reader.connections if topics is None or c.topic in topics]
        try:
            for connection, log_time_ns, data in self._reader.messages(wanted) if wanted else ():
                content = b"" if connection.topic in without_content else data
                if len(content) > self._limits.message_bytes:
                    self._reading_counters["messages_too_large"] += 1
                else:
                    yield RawMessage(self._channels[connection.id], log_time_ns, log_time_ns, 0, content)
        except (*_DAMAGE, OSError):
            self._is_complete = False

    def metadata(self) -> dict[str, dict[str, str]]:
        """None: such files hold only messages."""
        return {}

    def close(self) -> None:
        """Close the file."""
        self._reader.close()

    def _decompress(self, data: bytes) -> bytes:
        """A chunk, in no more memory than is allowed; the library would take as much as it asks for."""
        limit = self._limits.chunk_bytes
        if data.startswith(b"BZh"):
            data = bz2.BZ2Decompressor().decompress(data, max_length=limit + 1)
        elif data.startswith(b"\x04\x22\x4d\x18"):
            data = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=limit + 1)
        if len(data) > limit:
            raise ValueError(f"a chunk of more than {limit} bytes")
        return data


def _channel(connection: Connection) -> Channel:
    schema = Schema(connection.id, connection.msgtype, "ros1msg", connection.msgdef.data.encode())
    return Channel(connection.id, connection.topic, "ros1", schema)
