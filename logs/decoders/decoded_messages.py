"""What one pass over a log has decoded, kept for the next one."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

from logs.messages import Record

KEPT_BYTES = 32 * 2**20
"""Size of the messages, as they stand in the log, whose records are kept."""


@dataclass(frozen=True, slots=True, eq=False)
class DecodedMessage:
    """The records of a message, and a count of what was left out of them."""

    records: tuple[Record, ...]
    left_out: Counter[str]


class DecodedMessages:
    """The first messages of a pass, as many as ``KEPT_BYTES`` allow, by their number in it."""

    def __init__(self) -> None:
        self._kept: dict[int, DecodedMessage] = {}
        self._bytes_left = KEPT_BYTES

    def put(self, number: int, size: int, message: DecodedMessage) -> None:
        """Keep a message of ``size`` bytes; from the first on that does not fit, none is kept."""
        self._bytes_left -= size
        if self._bytes_left >= 0:
            self._kept[number] = message

    def take(self, number: int) -> DecodedMessage | None:
        """Hand out a message, which is kept no longer; None if it was not kept."""
        return self._kept.pop(number, None)
