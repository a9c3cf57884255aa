"""One message -> its records, for the part that its topic plays."""

from __future__ import annotations

from collections import Counter

from logs.container.limits import ReadingLimits
from logs.decoders.parts import Context, Records
from logs.decoders.registry import Decoder, decoder_of
from logs.errors import InvalidRecordError
from logs.messages import ImageDetections, LabelledScan, ObjectDetections, Odometry, Record, Transform
from logs.topics import RawMessage, RecordKind
from logs.validation import LAST_NS, Refusal

_LARGE = frozenset(
    {RecordKind.OBJECT_MAP, RecordKind.OBJECT_TRUTH, RecordKind.TRAJECTORY, RecordKind.FACTOR_GRAPH, RecordKind.DEPTH}
)  # each a whole result, or an image, in one message
_CLOUD = "sensor_msgs/msg/PointCloud2"
_NAMES = {
    ObjectDetections: ("frame_id", "labels"),
    ImageDetections: ("frame_id", "labels"),
    LabelledScan: ("frame_id",),
    Odometry: ("frame_id", "child_frame_id"),
    Transform: ("parent_frame_id", "child_frame_id"),
}
# What fields of other types than usual lead to; a log brings its own definitions.
_OTHER_FIELDS = (
    *(AttributeError, TypeError, ValueError, LookupError, OverflowError, MemoryError, RecursionError),
    InvalidRecordError,
)


def decode(
    raw: RawMessage,
    kind: RecordKind,
    counters: Counter[str] | None = None,
    limits: ReadingLimits | None = None,
    decoder: Decoder | None = None,
) -> Records:
    """The records of ``raw`` when its topic plays the part ``kind``; a message may hold none, one or several.

    Args:
        raw: the message.
        kind: one of ``kinds_of`` its channel.
        counters: counts what was left out of records that are otherwise good.
        limits: of objects, and of the length of names.
        decoder: instead of that of the schema.

    Raises:
        InvalidRecordError: the bytes are no such message, or hold values that no record may have, or more than the
            limits allow; names topic and time.
    """
    limits = limits or ReadingLimits()
    try:
        is_large = kind in _LARGE or raw.channel.schema_name == _CLOUD
        name, most = ("message_mb", limits.message_bytes) if is_large else ("objects", limits.input_bytes)
        if len(raw.data) > most:
            raise Refusal(f"too many bytes for limits.{name}", f"{len(raw.data)}, more than {most}")
        context = Context(raw, kind, Counter() if counters is None else counters)
        records = (decoder or decoder_of(raw.channel))(context)
        for record in records:
            _check(record, limits)
        return records
    except _OTHER_FIELDS as error:
        if not isinstance(error, Refusal):
            error = Refusal("a field has an unexpected type", str(error)[:200])
        raise InvalidRecordError(
            f"{raw.topic} at {raw.log_time_ns} ns: {error}; the message is left out", reason=error.reason
        ) from error


def _check(record: Record, limits: ReadingLimits) -> None:
    if not isinstance(record.stamp_ns, int):  # a definition that the log brings may say otherwise
        raise Refusal("time is not a whole number", f"{record.stamp_ns!r:.40} ns")
    if not 0 <= record.stamp_ns <= LAST_NS:
        raise Refusal("time out of range", f"{record.stamp_ns} ns")
    names: list[str] = []
    for field in _NAMES.get(type(record), ()):
        value = getattr(record, field)
        values = value if isinstance(value, tuple) else (value,)
        if len(values) > limits.objects:
            raise Refusal("more objects than limits.objects", f"{len(values)}, more than {limits.objects}")
        names += values
    if any(type(name) is not str for name in names):
        raise Refusal("name is not text")
    if max(map(len, names), default=0) > limits.name_length:
        raise Refusal("name longer than limits.name_length", f"more than {limits.name_length} characters")
