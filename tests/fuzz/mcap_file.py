"""An MCAP file as a list of records that can be altered and written again, and what such a file may say falsely."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from io import BytesIO
from typing import Any
from unittest.mock import patch

import numpy as np
from mcap.records import Chunk, Footer
from mcap.writer import CompressionType, IndexType, Writer

from logs.reader import LogReader
from logs.topics import Schema
from tests.fuzz.byte_mutations import one_of


@dataclass(frozen=True)
class Message:
    channel: int
    log_time_ns: int
    data: bytes
    sequence: int = 0


@dataclass
class McapFile:
    """What stands in the file: by number name, encoding and definition of a schema, and schema, topic and encoding of
    a channel.
    """

    schemas: dict[int, Sequence[Any]] = field(default_factory=dict)
    channels: dict[int, Sequence[Any]] = field(default_factory=dict)
    messages: list[Message] = field(default_factory=list)
    metadata: list[Sequence[Any]] = field(default_factory=list)

    def copy(self) -> "McapFile":
        """The same in lists, which can be altered."""
        schemas, channels = ({k: [*each] for k, each in table.items()} for table in (self.schemas, self.channels))
        return McapFile(schemas, channels, [*self.messages], [[name, {**values}] for name, values in self.metadata])


@dataclass(frozen=True)
class Layout:
    """How it is written, and the fields of ``chunk`` and ``footer`` that are not so."""

    compression: str = "zstd"
    messages_per_chunk: int = 100
    use_chunking: bool = True
    has_index: bool = True
    doubled_index: bool = False
    chunk: Mapping[str, Any] = field(default_factory=dict)
    footer: Mapping[str, Any] = field(default_factory=dict)


def read_file(path: str) -> McapFile:
    file = McapFile()
    with LogReader(path) as reader:
        numbers: dict[int, int] = {}
        schema_ids: dict[Schema | None, int] = {None: 0}
        for raw in reader.messages():
            channel, schema = raw.channel, raw.channel.schema
            number = numbers.setdefault(id(channel), len(numbers) + 1)
            schema_id = schema_ids.setdefault(schema, len(schema_ids))
            if schema is not None:
                file.schemas[schema_id] = schema
            file.channels[number] = (schema_id, channel.topic, channel.message_encoding)
            file.messages.append(Message(number, raw.log_time_ns, raw.data, raw.sequence))
        file.metadata = list(reader.metadata().items())
    return file


def write_file(file: McapFile, layout: Layout) -> bytes:
    """The bytes of ``file``, whole and valid but for what ``layout`` says falsely."""
    stream, has_index = BytesIO(), layout.has_index
    writer = Writer(
        stream,
        chunk_size=2**40,
        use_chunking=layout.use_chunking,
        compression=CompressionType[layout.compression.upper() or "NONE"],
        index_types=IndexType.ALL if has_index else IndexType.NONE,
        repeat_channels=has_index,
        repeat_schemas=has_index,
        use_statistics=has_index,
        use_summary_offsets=False,
    )
    with (
        patch("mcap.writer.Chunk", lambda **fields: Chunk(**fields | layout.chunk)),
        patch("mcap.writer.Footer", lambda **fields: Footer(**fields | layout.footer)),
    ):
        writer.start("", "fuzz")
        schemas = {id: writer.register_schema(*schema) for id, schema in file.schemas.items()}
        channels = {
            id: writer.register_channel(topic, encoding, schemas.get(schema, schema))
            for id, (schema, topic, encoding) in file.channels.items()
        }
        for number, m in enumerate(file.messages, start=1):
            writer.add_message(channels[m.channel], m.log_time_ns, m.data, m.log_time_ns, m.sequence)
            if number % layout.messages_per_chunk == 0:
                writer.flush()  # type: ignore[no-untyped-call]
        for name, values in file.metadata:
            writer.add_metadata(name, values)
        if layout.doubled_index:
            writer.flush()  # type: ignore[no-untyped-call]
            writer._Writer__chunk_indices *= 2  # type: ignore[attr-defined]
        writer.finish()  # type: ignore[no-untyped-call]
    return stream.getvalue()


def odd_layout(rng: np.random.Generator) -> Layout:
    """Of one in ten files each the chunks, or their times, are not as they say; of few the summary is elsewhere."""
    sizes, times = (0, 1, 2**30, 2**60, 2**64 - 1), (0, 5, 2**62, 2**63 - 1)
    chunk, footer = dict[str, int](), dict[str, int]()
    if rng.random() < 0.1:
        chunk["uncompressed_size"] = int(one_of(sizes, rng))
    if rng.random() < 0.1:
        chunk |= {f"message_{name}_time": int(rng.choice(times)) for name in ("start", "end")}
    if rng.random() < 0.03:
        footer = {"summary_start": int(rng.choice([8, 100, 2**40, 2**63 - 1])), "summary_crc": 0}
    return Layout(
        compression=str(rng.choice(["zstd", "lz4", ""])),
        messages_per_chunk=int(rng.choice([1, 7, 100, 10_000])),
        has_index=bool(rng.random() < 0.8),
        doubled_index=bool(rng.random() < 0.1),
        chunk=chunk,
        footer=footer,
    )
