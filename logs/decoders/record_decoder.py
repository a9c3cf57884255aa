"""The border of one pass over a log: raw messages in, records out, with a count of what was not fit to be one."""

from __future__ import annotations

import logging
from collections import Counter

from logs.container.limits import ReadingLimits
from logs.decoders.decode import decode
from logs.decoders.registry import kinds_of
from logs.errors import InvalidRecordError
from logs.messages import Record
from logs.selection import Selection
from logs.topics import RawMessage, Schema

MAX_DEFINITIONS = 32
"""Different definitions of messages in one log; further ones are not read, as each takes time and memory."""

_log = logging.getLogger(__name__)


class RecordDecoder:
    """Decodes the messages of the topics in ``selection``.

    ``counters``: ``invalid_messages``, ``undecodable`` (messages of a selected topic whose schema does not fit),
    ``dropped_objects``, ``ignored_covariances``, ``ignored_sizes``.
    """

    def __init__(self, selection: Selection, limits: ReadingLimits | None = None) -> None:
        self._selection = selection
        self._limits = limits or ReadingLimits()
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
        mapping = self._selection.mappings.get(raw.topic)
        kinds = [kind for kind in wanted if mapping is not None or kind in kinds_of(raw.channel)]
        if not kinds or not self._is_readable(raw.channel.schema):
            self.counters["undecodable"] += 1
            return ()
        records: tuple[Record, ...] = ()
        try:
            for kind in kinds:
                records += decode(raw, kind, self.counters, self._limits, None if mapping is None else mapping.decode)
        except InvalidRecordError as error:
            self.counters["invalid_messages"] += 1
            if (raw.topic, error.reason) not in self._reported:
                self._reported.add((raw.topic, error.reason))
                _log.warning("%s; further ones on this topic are only counted", error)
            return ()
        return records

    def _is_readable(self, schema: Schema | None) -> bool:
        if schema is None or schema in self._definitions:
            return True
        if len(self._definitions) == MAX_DEFINITIONS:
            return False
        self._definitions.add(schema)
        return True
