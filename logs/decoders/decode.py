"""Messages of a log -> records, with a count of what was not fit to be one."""

import logging
from collections import Counter
from collections.abc import Collection, Mapping
from typing import Any

from logs.container.limits import ReadingLimits
from logs.decoders import protobuf, ros2
from logs.decoders.field_mapping import FieldMapping
from logs.decoders.parts import Context, MessageDecoder, Records
from logs.errors import InvalidRecordError
from logs.messages import ImageDetections, ObjectDetections, Record
from logs.records import frames_of
from logs.topics import Channel, RawMessage, RecordKind, Schema
from logs.validation import LAST_NS, Refusal

MAX_DEFINITIONS = 32
"""Different definitions of messages in one log; further ones are not read, as each takes time and memory."""

_LARGE = frozenset(
    {RecordKind.OBJECT_MAP, RecordKind.OBJECT_TRUTH, RecordKind.TRAJECTORY, RecordKind.FACTOR_GRAPH, RecordKind.DEPTH}
)  # each a whole result, or an image, in one message
_CLOUD = "sensor_msgs/msg/PointCloud2"
# What fields of other types than usual lead to; a log brings its own definitions.
_OTHER_FIELDS = (
    AttributeError,
    TypeError,
    ValueError,
    LookupError,
    OverflowError,
    MemoryError,
    RecursionError,
    InvalidRecordError,
)

_log = logging.getLogger(__name__)


def kinds_of(channel: Channel) -> tuple[RecordKind, ...]:
    """What the messages of ``channel`` can be decoded to; () for a schema or an encoding that is not known."""
    known = _decoders_for(channel).get(channel.schema_name)
    return () if known is None else known.kinds


def _decoders_for(channel: Channel) -> Mapping[str, MessageDecoder]:
    """Schema -> decoder, of the encoding of a channel."""
    if channel.message_encoding in ("protobuf", "json"):
        return protobuf.DECODERS
    is_ros2 = channel.schema is not None and channel.schema.encoding in ("ros2msg", "ros2idl")
    return ros2.DECODERS if channel.message_encoding == "cdr" and is_ros2 else {}


def decode(
    raw: RawMessage,
    kind: RecordKind,
    counters: Counter[str] | None = None,
    limits: ReadingLimits | None = None,
    mapping: FieldMapping | None = None,
) -> Records:
    """The records of ``raw`` when its topic plays the part ``kind``; a message may hold none, one or several.

    Args:
        raw: the message.
        kind: one of ``kinds_of`` its channel.
        counters: counts what was left out of records that are otherwise good.
        limits: of objects, and of the length of names.
        mapping: where the fields of detections are, in a message of a schema that is not known.

    Raises:
        InvalidRecordError: the bytes are no such message, or hold values that no record may have, or more than the
            limits allow; names topic and time.
    """
    limits = limits or ReadingLimits()
    try:
        is_large = kind in _LARGE or raw.channel.schema_name == _CLOUD
        # Parsed, a message of measurements may take a hundred times as much.
        most = limits.message_bytes if is_large else 512 * limits.objects
        if len(raw.data) > most:
            raise Refusal("too many bytes for memory_mb", f"{len(raw.data)}, more than {most}")
        context = Context(raw, kind, Counter() if counters is None else counters)
        records = _records(context) if mapping is None else mapping.decode(context)
        for record in records:
            _check(record, limits)
        return records
    except _OTHER_FIELDS as error:
        if not isinstance(error, Refusal):
            error = Refusal("a field has an unexpected type", str(error)[:200])
        raise InvalidRecordError(
            f"{raw.topic} at {raw.log_time_ns} ns: {error}; the message is left out", reason=error.reason
        ) from error


def _records(context: Context) -> Records:
    raw = context.raw
    known = _decoders_for(raw.channel)[raw.channel.schema_name]
    message: Any
    if known.message_class is not None:
        message = protobuf.parse(raw, known.message_class)
    else:
        from logs.decoders.cdr import parse  # loads rosbags

        message = parse(raw)
    return known.records(message, context)


def _check(record: Record, limits: ReadingLimits) -> None:
    if not 0 <= record.stamp_ns <= LAST_NS:
        raise Refusal("time out of range", f"{record.stamp_ns} ns")
    names = [*frames_of(record).values()]
    if isinstance(record, ObjectDetections | ImageDetections):
        if len(record.labels) > limits.objects:
            raise Refusal("too many objects for memory_mb", f"{len(record.labels)}, more than {limits.objects}")
        names += record.labels
    if {*map(type, names)} - {str}:
        raise Refusal("name is not text")
    if max(map(len, names), default=0) > limits.name_length:
        raise Refusal("name too long for memory_mb", f"more than {limits.name_length} characters")


class RecordDecoder:
    """Decodes the messages of a log, and counts those that are unfit.

    ``counters``: ``invalid_messages``, ``undecodable`` (messages whose schema does not fit), ``dropped_objects``,
    ``ignored_covariances``. Invalid messages are reported once for each topic and reason.
    """

    def __init__(self, limits: ReadingLimits | None = None) -> None:
        self._limits = limits
        self._definitions: set[Schema | None] = set()
        self._reported = set[tuple[str, str]]()
        self.counters = Counter[str]()

    def records(self, raw: RawMessage, wanted: Collection[RecordKind], mapping: FieldMapping | None = None) -> Records:
        """The records of ``raw`` for those of the ``wanted`` kinds that its schema, or ``mapping``, can give."""
        kinds = [kind for kind in wanted if mapping is not None or kind in kinds_of(raw.channel)]
        if len(self._definitions) < MAX_DEFINITIONS:
            self._definitions.add(raw.channel.schema)
        if not kinds or raw.channel.schema not in self._definitions:
            self.counters["undecodable"] += 1
            return ()
        try:
            return tuple(record for kind in kinds for record in decode(raw, kind, self.counters, self._limits, mapping))
        except InvalidRecordError as error:
            self.counters["invalid_messages"] += 1
            if (raw.topic, error.reason) not in self._reported:
                self._reported.add((raw.topic, error.reason))
                _log.warning("%s; further ones on this topic are only counted", error)
            return ()
