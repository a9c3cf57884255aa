"""Limits on the memory that a file may take."""

import math
from dataclasses import astuple

from logs.errors import UnreadableLogError
from logs.records import frozen


@frozen
class ReadingLimits:
    """What goes beyond is left out and counted, or refused where nothing would be left; the error names the setting
    that all are in proportion to, ``memory_mb``.

    ``chunk_bytes``: of one chunk, decompressed; ``message_bytes``: of one message that is decoded; ``waiting_bytes``:
    of the messages that wait because chunks overlap in time; ``metadata_bytes``: of all metadata; ``channels``: of
    channels and of schemas; ``objects``: in one message; ``name_length``: of a topic, a class or a frame, in
    characters.
    """

    chunk_bytes: int = 64_000_000
    message_bytes: int = 16_000_000
    waiting_bytes: int = 64_000_000
    metadata_bytes: int = 8_000_000
    channels: int = 4096
    objects: int = 5000
    name_length: int = 1000

    def scaled(self, factor: float) -> "ReadingLimits":
        """Limits that are all so many times as large, one at least."""
        return ReadingLimits(*(max(round(factor * limit), 1) for limit in astuple(self)))

    @property
    def chunk_mb(self) -> float:
        """The setting ``memory_mb`` that has these limits."""
        return self.chunk_bytes / 1e6

    def check(self, file: str, count: int, what: str, most: int) -> None:
        """Refuse a file with so many of something; ``most`` is one of these limits.

        Raises:
            UnreadableLogError: there are more than ``most``; with the setting that allows them.
        """
        if count > most:
            memory_mb = math.ceil(self.chunk_mb * count / most)
            raise UnreadableLogError(
                f"{file}: {count} {what}, more than {most}; if you trust the file, --set memory_mb={memory_mb}"
            )


RESULT_LIMITS = ReadingLimits(chunk_bytes=10**9, message_bytes=10**9, waiting_bytes=10**9)
"""Of logs that a replay wrote: a map and a graph are one message each."""
