"""One SQLite file of rosbag2 (.db3)."""

from __future__ import annotations

import sqlite3
from collections.abc import Collection, Iterator
from pathlib import Path

from logs.container.limits import ReadingLimits
from logs.errors import UnreadableLogError
from logs.storage.ros2_definitions import known_definition
from logs.storage.storage import ChannelInfo, Storage
from logs.topics import Channel, RawMessage, Schema
from logs.validation import LAST_NS

# The messages of SQLite's errors quote the file, and quotes that are no UTF-8 fail to decode.
_DATABASE_ERRORS = (sqlite3.Error, UnicodeDecodeError)
_TABLES = (
    "SELECT name FROM sqlite_master AS t WHERE type = 'table' AND rootpage > 0 "
    "AND NOT EXISTS (SELECT 1 FROM pragma_table_xinfo(t.name) WHERE hidden > 1)"
)

_SPANS = (
    "SELECT topic_id, COUNT(*), MIN(timestamp), MAX(timestamp) FROM messages WHERE typeof(timestamp) = 'integer' "
    "GROUP BY topic_id"
)


class SqliteFile(Storage):
    """The rosbag2 database at ``path``.

    Messages come in the order of log time, those of equal time in the order in which they were recorded; messages of
    other topics than the wanted ones are not read. Databases written before ROS 2 Iron hold no definitions of their
    messages; for those types that can be used, they are added.

    Raises:
        UnreadableLogError: the file is no such database, or is damaged; ``name`` is what the message calls it.
    """

    def __init__(self, path: Path, name: str, limits: ReadingLimits) -> None:
        super().__init__(name, limits)
        try:
            self._database = sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)
            self._channels = self._read_channels()
        except _DATABASE_ERRORS as error:
            raise UnreadableLogError(
                f"cannot read {name}: {error}; not a rosbag2 database, or a damaged one"
            ) from error

    def channels(self) -> list[ChannelInfo]:
        """The channels, with their numbers of messages and their times."""
        return list(self._channels.values())

    def messages(
        self, topics: Collection[str] | None = None, without_content: Collection[str] = ()
    ) -> Iterator[RawMessage]:
        """See :class:`Storage`; counted are ``truncated`` (1: it could not be read to its end) and what is left out."""
        self._counters.clear()
        wanted = {id: i.channel for id, i in self._channels.items() if topics is None or i.channel.topic in topics}
        empty = [id for id, channel in wanted.items() if channel.topic in without_content]
        query = (
            "SELECT id, topic_id, timestamp, "
            f"CASE WHEN topic_id IN ({_marks(empty)}) THEN x'' WHEN length(data) <= ? THEN data END "
            f"FROM messages WHERE topic_id IN ({_marks(wanted)}) ORDER BY timestamp, id"
        )
        parameters = (*empty, self._limits.message_bytes, *wanted)
        try:
            for id, topic_id, log_time_ns, data in self._database.execute(query, parameters):
                if not (isinstance(log_time_ns, int) and 0 <= log_time_ns <= LAST_NS):
                    self._counters["messages_without_time"] += 1
                elif data is None:
                    self._counters["messages_too_large"] += 1
                else:  # SQLite puts what it likes into any column
                    content = data if isinstance(data, bytes) else b""
                    sequence = id % 2**32 if isinstance(id, int) else 0
                    yield RawMessage(wanted[topic_id], log_time_ns, log_time_ns, sequence, content)
        except _DATABASE_ERRORS:
            self._counters["truncated"] = 1

    def close(self) -> None:
        """Close the file."""
        self._database.close()

    def _read_channels(self) -> dict[int, ChannelInfo]:
        tables = {name for (name,) in self._database.execute(_TABLES)}
        if missing := {"messages", "topics"} - tables:
            raise sqlite3.DatabaseError(f"no table {' and '.join(sorted(missing))}")
        definitions = self._read_definitions() if "message_definitions" in tables else {}
        spans = {id: span for id, *span in self._database.execute(_SPANS)}
        channels: dict[int, ChannelInfo] = {}
        for id, *texts in self._database.execute("SELECT id, name, type, serialization_format FROM topics ORDER BY id"):
            if not isinstance(id, int) or not all(isinstance(text, str) for text in texts):
                raise sqlite3.DatabaseError(f"topic {texts[0]!r} of type {texts[1]!r} in {texts[2]!r}")
            topic, type_name, encoding = texts
            self._limits.check_name(self._name, "a topic", topic)
            self._limits.check_name(self._name, "a type", type_name)
            schema = Schema(id, type_name, *(definitions.get(type_name) or known_definition(type_name)))
            channels[id] = ChannelInfo(Channel(id, topic, encoding, schema), *spans.get(id, (0, None, None)))
            self._limits.check_channels(self._name, len(channels))
        return channels

    def _read_definitions(self) -> dict[str, tuple[str, bytes]]:
        """Type name -> (encoding, definition)."""
        rows = self._database.execute(
            "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions "
            "WHERE typeof(encoding) = 'text' AND typeof(encoded_message_definition) = 'text' "
            "AND length(encoded_message_definition) <= ? ORDER BY id",
            (self._limits.message_bytes,),
        )
        return {type_name: (encoding, text.encode()) for type_name, encoding, text in rows}


def _marks(parameters: Collection[int]) -> str:
    return ",".join("?" * len(parameters))
