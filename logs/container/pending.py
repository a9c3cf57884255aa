"""The messages of one block, in the order of log time, held as bytes until their turn comes."""

from __future__ import annotations

from array import array
from collections.abc import Collection, Mapping

import numpy as np

from logs import blocks
from logs.topics import Channel, RawMessage
from logs.validation import LAST_NS

_HEADER = blocks.MESSAGE_HEADER


class PendingMessages:
    """Messages on the channels ``wanted`` among the records ``content`` of a block.

    Those on channels in ``without_content`` come empty. ``oversized`` and ``without_time`` count those that were left
    out because they have more than ``max_bytes``, or a time after :data:`LAST_NS`.
    """

    def __init__(
        self, content: bytes, wanted: Mapping[int, Channel], without_content: Collection[int], max_bytes: int
    ) -> None:
        self.oversized = 0
        self.without_time = 0
        self._wanted = wanted
        kept = bytearray()
        ends, times = array("q"), array("q")
        view = memoryview(content)
        for opcode, begin, end in blocks.records(content):
            if opcode != blocks.MESSAGE:
                continue
            id, _, log_time_ns, _ = _HEADER.unpack_from(content, begin)
            if id not in wanted:
                continue
            if log_time_ns > LAST_NS:
                self.without_time += 1
                continue
            is_empty = id in without_content
            if end - begin > max_bytes and not is_empty:
                self.oversized += 1
            else:
                kept += view[begin : begin + _HEADER.size if is_empty else end]
                ends.append(len(kept))
                times.append(log_time_ns)
        self._content = bytes(kept)
        self._ends = ends
        self._times = times
        self._order = np.argsort(np.frombuffer(times, dtype=np.int64), kind="stable") if times else np.zeros(0, int)
        self._place = 0

    def __len__(self) -> int:
        """How many are left."""
        return len(self._order) - self._place

    @property
    def size_bytes(self) -> int:
        """Of all that is held."""
        return len(self._content) + 24 * len(self._order)

    @property
    def next_ns(self) -> int:
        """Log time of the next message."""
        return self._times[int(self._order[self._place])]

    def take(self) -> RawMessage:
        """The next message."""
        index = int(self._order[self._place])
        self._place += 1
        start = self._ends[index - 1] if index else 0
        id, sequence, log_time_ns, publish_time_ns = _HEADER.unpack_from(self._content, start)
        content = self._content[start + _HEADER.size : self._ends[index]]
        return RawMessage(self._wanted[id], log_time_ns, publish_time_ns, sequence, content)
