"""The border of one pass over a log: raw messages in, records out, with a count of what was not fit to be one."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Collection

from logs.container.limits import ReadingLimits
from logs.decoders.decode import decode
from logs.decoders.field_mapping import FieldMapping
from logs.decoders.parts import Records
from logs.decoders.registry import kinds_of
from logs.errors import InvalidRecordError
from logs.topics import RawMessage, RecordKind, Schema

MAX_DEFINITIONS = 32
"""Different definitions of messages in one log; further ones are not read, as each takes time and memory."""

_log = logging.getLogger(__name__)


class RecordDecoder:
    """Decodes messages, and counts those that are unfit.

    ``counters``: ``invalid_messages``, ``undecodable`` (messages whose schema does not fit), ``dropped_objects``,
    ``ignored_covariances``. Invalid messages are reported once for each topic and reason;
    ``reported``: the topics and reasons that earlier passes reported.
    """

    def __init__(
        self,
        limits: ReadingLimits | None = None,
        counters: Counter[str] | None = None,
        reported: set[tuple[str, str]] | None = None,
    ) -> None:
        self._limits = limits or ReadingLimits()
        self._definitions: set[Schema | None] = set()
        self._reported = set[tuple[str, str]]() if reported is None else reported
        self.counters = Counter[str]() if counters is None else counters

    def records(self, raw: RawMessage, wanted: Collection[RecordKind], mapping: FieldMapping | None = None) -> Records:
        """The records of ``raw`` for those of the ``wanted`` kinds that its schema, or ``mapping``, can give."""
        kinds = [kind for kind in wanted if mapping is not None or kind in kinds_of(raw.channel)]
        self._definitions |= {raw.channel.schema} if len(self._definitions) < MAX_DEFINITIONS else set()
        if not kinds or raw.channel.schema not in self._definitions:
            self.counters["undecodable"] += 1
            return ()
        records: Records = ()
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
