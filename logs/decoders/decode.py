"""One message -> its records, for the part that its topic plays."""

from __future__ import annotations

from collections import Counter

from logs.decoders.registry import decoder_for, kinds_of
from logs.errors import InvalidRecordError
from logs.messages import Record
from logs.topics import RawMessage, RecordKind
from logs.validation import Refusal


def decode(raw: RawMessage, kind: RecordKind, counters: Counter[str] | None = None) -> tuple[Record, ...]:
    """The records of ``raw`` when its topic plays the part ``kind``; a message may hold none, one or several.

    Args:
        raw: the message.
        kind: one of ``kinds_of`` its channel.
        counters: counts what was left out of records that are otherwise good.

    Raises:
        InvalidRecordError: the bytes are no such message, or hold values that no record may have; names topic and time.
        KeyError: the schema is unknown or has no such kind.
    """
    decoder = decoder_for(raw.channel)
    if decoder is None or kind not in kinds_of(raw.channel):
        raise KeyError(f"{raw.topic}: {raw.channel.schema_name!r} does not decode to {kind}")
    try:
        return decoder(raw, kind, Counter() if counters is None else counters)
    except Refusal as refusal:
        raise InvalidRecordError(
            f"{raw.topic} at {raw.log_time_ns} ns: {refusal}; the message is left out", reason=refusal.reason
        ) from refusal
