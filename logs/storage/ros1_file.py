"""One bag of ROS 1 (.bag)."""

from __future__ import annotations

import bz2
from collections.abc import Collection, Iterator
from pathlib import Path

import lz4.frame
from rosbags.rosbag1 import Reader, ReaderError

from logs.container.limits import ReadingLimits
from logs.errors import UnreadableLogError
from logs.storage.mcap_index import DAMAGE
from logs.storage.storage import ChannelInfo, Storage
from logs.topics import Channel, RawMessage, Schema

_DAMAGE = (*DAMAGE, ReaderError, AssertionError, LookupError, OSError)


class Ros1File(Storage):
    """The bag at ``path``.

    Messages come in the order of log time, in the encoding "ros1", up to the first damaged chunk.

    Raises:
        UnreadableLogError: the bag is damaged or was not closed; ``name`` is what the message calls it.
    """

    def __init__(self, path: Path, name: str, limits: ReadingLimits) -> None:
        super().__init__(name, limits)
        self._reader = Reader(path)
        try:
            self._reader.open()
        except _DAMAGE as error:
            raise UnreadableLogError(f"cannot read {name}: {error}; 'rosbag reindex' repairs a damaged bag") from error
        self._channels: dict[int, Channel] = {}
        limits.check_channels(name, len(self._reader.connections))
        for each in self._reader.connections:
            limits.check_name(name, "a topic", each.topic)
            limits.check_name(name, "a type", each.msgtype)
            schema = Schema(each.id, each.msgtype, "ros1msg", each.msgdef.data.encode())
            self._channels[each.id] = Channel(each.id, each.topic, "ros1", schema)
        for offset, chunk in self._reader.chunks.items():
            self._reader.chunks[offset] = chunk._replace(decompressor=self._decompress)

    def channels(self) -> list[ChannelInfo]:
        """The channels, with their numbers of messages and the times of the bag."""
        span = self._reader.start_time, self._reader.end_time
        return [
            ChannelInfo(self._channels[each.id], each.msgcount, *(span if each.msgcount else (None, None)))
            for each in self._reader.connections
        ]

    def messages(
        self, topics: Collection[str] | None = None, without_content: Collection[str] = ()
    ) -> Iterator[RawMessage]:
        """See :class:`Storage`; counted are ``truncated`` (1: it could not be read to its end) and what is left out."""
        self._counters.clear()
        wanted = [each for each in self._reader.connections if topics is None or each.topic in topics]
        try:
            for connection, log_time_ns, data in self._reader.messages(wanted) if wanted else ():
                content = b"" if connection.topic in without_content else data
                if len(content) > self._limits.message_bytes:
                    self._counters["messages_too_large"] += 1
                else:
                    yield RawMessage(self._channels[connection.id], log_time_ns, log_time_ns, 0, content)
        except _DAMAGE:
            self._counters["truncated"] = 1

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
