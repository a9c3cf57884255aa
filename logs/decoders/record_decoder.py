"""The border of one pass over a log: raw messages in, records out, with a count of what was not fit to be one."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Sequence

from logs.container.limits import ReadingLimits
from logs.decoders.decode import decode
from logs.decoders.decoded_messages import DecodedMessage, DecodedMessages
from logs.decoders.registry import kinds_of
from logs.errors import InvalidRecordError
from logs.messages import Record
from logs.selection import Selection
from logs.topics import RawMessage, RecordKind, Schema

MAX_DEFINITIONS = 32
"""Different definitions of messages in one log; further ones are not read, as each takes time and memory."""

_log = logging.getLogger(__name__)


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
        self._known = known
        self._kept = kept
        self._number = 0
        self._definitions: set[Schema] = set()
        self._told: set[tuple[str, str]] = set()
        self.counters: Counter[str] = Counter()

    def records(self, raw: RawMessage) -> tuple[Record, ...]:
        """The records of ``raw``: none where its topic is not selected or the message is unfit.

        Unfit messages are counted, and told in the log once for each topic and reason.
        """
        wanted = self._selection.kinds.get(raw.topic, ())
        if not wanted:
            return ()
        possible = [kind for kind in wanted if kind in kinds_of(raw.channel)]
        if not possible or not self._is_readable(raw.channel.schema):
            self.counters["undecodable"] += 1
            return ()
        message = None if self._known is None else self._known.take(self._number)
        try:
            message = message or self._decode(raw, possible)
        except InvalidRecordError as error:
            self.counters["invalid_messages"] += 1
            if (raw.topic, error.reason) not in self._told:
                self._told.add((raw.topic, error.reason))
                _log.warning("%s; more of the same on this topic is only counted", error)
            return ()
        finally:
            self._number += 1
        if self._kept is not None:
            self._kept.put(self._number - 1, len(raw.data), message)
        if message.left_out:
            self.counters.update(message.left_out)
        return message.records

    def _decode(self, raw: RawMessage, kinds: Sequence[RecordKind]) -> DecodedMessage:
        left_out = Counter[str]()
        try:
            found = [decode(raw, kind, left_out, self._limits) for kind in kinds]
        except InvalidRecordError:
            self.counters.update(left_out)
            raise
        records = found[0] if len(found) == 1 else tuple(record for some in found for record in some)
        return DecodedMessage(records, left_out)

    def _is_readable(self, schema: Schema | None) -> bool:
        if schema is None or schema in self._definitions:
            return True
        if len(self._definitions) == MAX_DEFINITIONS:
            return False
        self._definitions.add(schema)
        return True
