"""Messages of a log as a stream of bytes, from standard input or a socket: each after its length as a varint."""

from collections import Counter
from collections.abc import Iterator
from typing import Any

from google.protobuf.message import DecodeError
from google.protobuf.proto import parse_length_prefixed, serialize_length_prefixed

from logs.container.limits import ReadingLimits
from logs.decoders.decode import RecordDecoder, kinds_of
from logs.encoders import encode
from logs.errors import UnreadableLogError
from logs.messages import Record
from logs.reader import LogItem
from logs.schemas.dslam_pb2 import StreamMessage
from logs.topics import Channel, RawMessage, RecordKind, Schema

INPUT_KINDS = RecordKind.TRANSFORMS, RecordKind.ODOMETRY, RecordKind.DETECTIONS, RecordKind.GNSS
"""A message is decoded to the first of these that its schema may be."""


def read_stream(stream: Any, counters: Counter[str], limits: ReadingLimits | None = None) -> Iterator[LogItem]:
    """The messages of a binary ``stream`` until its end; ``counters`` counts those that are no input of a map.

    Raises:
        UnreadableLogError: bytes that are no stream of messages.
    """
    decoder = RecordDecoder(limits)
    decoder.counters = counters
    while True:
        try:
            message = parse_length_prefixed(StreamMessage, stream)
        except (DecodeError, ValueError) as error:
            raise UnreadableLogError(
                f"the stream holds bytes that are not a dslam.StreamMessage after its length: {error}"
            ) from error
        if message is None:
            return
        channel = Channel(message.topic, "protobuf", Schema(message.schema, "protobuf", b""))
        raw = RawMessage(channel, message.log_time_ns, message.log_time_ns, 0, message.data)
        kinds = [kind for kind in INPUT_KINDS if kind in kinds_of(channel)]
        yield LogItem(raw, decoder.records(raw, kinds[:1]))


def write_stream(stream: Any, topic: str, record: Record, log_time_ns: int) -> None:
    """Append a record to a binary ``stream``."""
    encoded = encode(record)
    message = StreamMessage(
        topic=topic,
        schema=encoded.DESCRIPTOR.full_name,
        log_time_ns=log_time_ns,
        data=encoded.SerializeToString(deterministic=True),
    )
    serialize_length_prefixed(message, stream)
