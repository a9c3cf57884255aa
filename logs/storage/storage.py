"""What every kind of file offers to the reader of a log."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass

from logs.container.limits import ReadingLimits
from logs.topics import Channel, RawMessage


@dataclass(frozen=True, slots=True)
class ChannelInfo:
    """A channel and its messages; the first and last log times are None where the file does not tell them."""

    channel: Channel
    message_count: int
    first_ns: int | None
    last_ns: int | None


class Storage(ABC):
    """One open file with messages."""

    def __init__(self, name: str, limits: ReadingLimits) -> None:
        self._name = name
        self._limits = limits
        self._counters: Counter[str] = Counter()

    @property
    def counters(self) -> Mapping[str, int]:
        """What was lost so far, by name, or what was left out by the latest pass over messages."""
        return self._counters

    @abstractmethod
    def channels(self) -> list[ChannelInfo]:
        """The channels, and what is known of their messages."""

    @abstractmethod
    def messages(
        self, topics: Collection[str] | None = None, without_content: Collection[str] = ()
    ) -> Iterator[RawMessage]:
        """Undecoded messages of ``topics`` (None: of all), in the order of log time; some of them without content."""

    def metadata(self) -> dict[str, dict[str, str]]:
        """Metadata by name; of several under one name the last."""
        return {}

    @abstractmethod
    def close(self) -> None:
        """Close the file."""
