"""Limits on the memory that a file may take."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from logs.errors import UnreadableLogError


@dataclass(frozen=True)
class ReadingLimits:
    """What goes beyond is left out and counted, or refused where nothing would be left; the error names the setting
    that all are in proportion to, ``memory_mb``.

    ``chunk_mb``: of one chunk, decompressed; ``message_mb``: of one message that is decoded; ``waiting_mb``: of
    the messages that wait because chunks overlap in time; ``metadata_mb``: of all metadata; ``channels``: of channels
    and of schemas; ``objects``: in one message; ``name_length``: of a topic, a class or a frame, in characters.
    """

    chunk_mb: float = 64.0
    message_mb: float = 16.0
    waiting_mb: float = 64.0
    metadata_mb: float = 8.0
    channels: int = 4096
    objects: int = 5000
    name_length: int = 1000

    def scaled(self, factor: float) -> ReadingLimits:
        """Limits that are all so many times as large; counts are one at least."""
        values = {each.name: factor * getattr(self, each.name) for each in fields(self)}
        counts = {name: max(round(values[name]), 1) for name in ("channels", "objects", "name_length")}
        return ReadingLimits(**(values | counts))

    @property
    def chunk_bytes(self) -> int:
        """``chunk_mb`` in bytes."""
        return round(1e6 * self.chunk_mb)

    @property
    def message_bytes(self) -> int:
        """``message_mb`` in bytes."""
        return round(1e6 * self.message_mb)

    @property
    def input_bytes(self) -> int:
        """Of one message of measurements: parsed, it may take a hundred times as much."""
        return self.objects * 512

    def check_channels(self, file: str, count: int) -> None:
        """Refuse a file with so many channels, or schemas.

        Raises:
            UnreadableLogError: there are more than ``channels``.
        """
        if count > self.channels:
            raise UnreadableLogError(
                f"{file} has more than {self.channels} channels or schemas; {self._remedy(count / self.channels)}"
            )

    def check_name(self, file: str, what: str, name: str) -> None:
        """Refuse a file with so long a name of ``what``.

        Raises:
            UnreadableLogError: it has more than ``name_length`` characters.
        """
        if len(name) > self.name_length:
            raise UnreadableLogError(
                f"{file}: the name of {what} has {len(name)} characters, more than {self.name_length}; "
                + self._remedy(len(name) / self.name_length)
            )

    def _remedy(self, times: float) -> str:
        """How a file is read that needs so many times what is allowed."""
        return f"if you trust the file, --set memory_mb={math.ceil(self.chunk_mb * times)}"


RESULT_LIMITS = ReadingLimits(chunk_mb=1000.0, message_mb=1000.0, waiting_mb=1000.0)
"""Of logs that a replay wrote: a map and a graph are one message each."""
