"""The border of one pass over a log: raw messages in, records out, with a count of what was not fit to be one."""

from __future__ import annotations

import logging
from collections import Counter
from dataclasses import dataclass, field

from logs.container.limits import ReadingLimits
from logs.decoders.decode import decode
from logs.decoders.registry import kinds_of
from logs.errors import InvalidRecordError
from logs.messages import Record
from logs.selection import Selection
from logs.topics import RawMessage, Schema

MAX_DEFINITIONS = 32
"""Different definitions of messages in one log; further ones are not read, as each takes time and memory."""
KEPT_BYTES = 32 * 2**20
"""Size of the messages, as they stand in the log, whose records are kept for the next pass."""

_log = logging.getLogger(__name__)


@dataclass(slots=True, eq=False)
class DecodedMessages:
    """Records of the first messages of a pass by their number, as many as ``KEPT_BYTES`` allow, and of each a count of
    what was left out.
    """

    messages: dict[int, tuple[tuple[Record, ...], Counter[str]]] = field(default_factory=dict)
    bytes_left: int = field(default_factory=lambda: KEPT_BYTES)


class RecordDecoder:
    """Decodes the messages of the topics in ``selection``.

    ``counters``: ``invalid_messages``, ``undecodable`` (messages of a selected topic whose schema does not fit),
    ``dropped_objects``, ``ignored_covariances``, ``ignored_sizes``.
    """

    def __init__(
        self,
        selection: Selection,
        limits: ReadingLimits | None = None,
        *,
        known: DecodedMessages | None = None,
        kept: DecodedMessages | None = None,
    ) -> None:
        """``known``: what an earlier pass over the same messages has decoded; ``kept``: where this one keeps it."""
        self._selection = selection
        self._limits = limits or ReadingLimits()
        self._known = known or DecodedMessages()
        self._kept = kept
        self._number = -1
        self._definitions: set[Schema] = set()
        self._reported: set[tuple[str, str]] = set()
        self.counters: Counter[str] = Counter()

    def records(self, raw: RawMessage) -> tuple[Record, ...]:
        """The records of ``raw``: none where its topic is not selected or the message is unfit.

        Unfit messages are counted, and reported in the log once for each topic and reason.
        """
        wanted = self._selection.kinds.get(raw.topic, ())
        if not wanted:
            return ()
        kinds = [kind for kind in wanted if kind in kinds_of(raw.channel)]
        if not kinds or not self._is_readable(raw.channel.schema):
            self.counters["undecodable"] += 1
            return ()
        self._number += 1
        known = self._known.messages.pop(self._number, None)
        records, left_out = known or ((), Counter[str]())
        try:
            for kind in kinds if known is None else ():
                records += decode(raw, kind, left_out, self._limits)
            if self._kept is not None:
                self._keep(self._kept, len(raw.data), records, left_out)
        except InvalidRecordError as error:
            records = ()
            self.counters["invalid_messages"] += 1
            if (raw.topic, error.reason) not in self._reported:
                self._reported.add((raw.topic, error.reason))
                _log.warning("%s; more of the same on this topic is only counted", error)
        if left_out:
            self.counters.update(left_out)
        return records

    def _keep(self, kept: DecodedMessages, size: int, records: tuple[Record, ...], left_out: Counter[str]) -> None:
        kept.bytes_left -= size
        if kept.bytes_left >= 0:
            kept.messages[self._number] = records, left_out

    def _is_readable(self, schema: Schema | None) -> bool:
        if schema is None or schema in self._definitions:
            return True
        if len(self._definitions) == MAX_DEFINITIONS:
            return False
        self._definitions.add(schema)
        return True
