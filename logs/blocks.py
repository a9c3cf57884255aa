"""The framing of an MCAP file, read so that damage anywhere costs no more than the block it lies in.

A block is a chunk, or a run of records outside of chunks. Where a file has no usable index, one walk over the record
headers finds the blocks again; nothing is decompressed for it.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import BinaryIO

MAGIC = b"\x89MCAP0\r\n"

SCHEMA, CHANNEL, MESSAGE, CHUNK = 0x03, 0x04, 0x05, 0x06
ATTACHMENT, METADATA, DATA_END = 0x09, 0x0C, 0x0F

HEADER = struct.Struct("<BQ")  # opcode, length of what follows
MESSAGE_HEADER = struct.Struct("<HIQQ")  # channel id, sequence, log time, publish time
_CHUNK_TIMES = struct.Struct("<QQ")  # first and last log time
_RUN_BYTES = 1 << 20  # records outside of chunks are read in runs of about this size


@dataclass(frozen=True, slots=True)
class Block:
    """Bytes [offset, offset + length) of the file, with messages of log times [start_ns, end_ns], both included.

    ``channel_ids`` are those that may be in it, None where the file does not say.
    """

    offset: int
    length: int
    start_ns: int
    end_ns: int
    is_chunk: bool
    channel_ids: frozenset[int] | None = None


@dataclass(slots=True)
class BlockList:
    """What a walk over a file found. ``lost_bytes`` at its end could not be read as records.

    ``oversized``: offset -> bytes of records outside of chunks that are too large to be read.
    """

    blocks: list[Block] = field(default_factory=list)
    metadata_offsets: list[int] = field(default_factory=list)
    attachment_offsets: list[int] = field(default_factory=list)
    oversized: dict[int, int] = field(default_factory=dict)
    is_complete: bool = False
    lost_bytes: int = 0


def walk(stream: BinaryIO, size: int, max_record_bytes: int = 1 << 32) -> BlockList:
    """Find the blocks of a file of ``size`` bytes, up to its data end or to where the records stop making sense.

    Records outside of chunks that have more than ``max_record_bytes`` are left out.
    """
    found = BlockList()
    offset = run_start = len(MAGIC)
    run_times: list[int] = []

    def end_run() -> None:
        if offset > run_start:
            times = run_times or [0]
            found.blocks.append(Block(run_start, offset - run_start, min(times), max(times), is_chunk=False))
        run_times.clear()

    while not found.is_complete:
        stream.seek(offset)
        head = stream.read(HEADER.size + MESSAGE_HEADER.size)
        if len(head) < HEADER.size:
            break
        opcode, length = HEADER.unpack_from(head)
        end = offset + HEADER.size + length
        if opcode == 0 or end > size:
            break
        if opcode in (SCHEMA, CHANNEL, MESSAGE) and length <= max_record_bytes:
            if opcode == MESSAGE and length >= MESSAGE_HEADER.size:
                run_times.append(MESSAGE_HEADER.unpack_from(head, HEADER.size)[2])
            if end - run_start > _RUN_BYTES:
                offset = end
                end_run()
                run_start = offset
        else:
            end_run()
            run_start = end
            if opcode == CHUNK and length >= _CHUNK_TIMES.size:
                start_ns, end_ns = _CHUNK_TIMES.unpack_from(head, HEADER.size)
                found.blocks.append(Block(offset, end - offset, start_ns, end_ns, is_chunk=True))
            elif opcode == METADATA:
                found.metadata_offsets.append(offset)
            elif opcode == ATTACHMENT:
                found.attachment_offsets.append(offset)
            elif opcode in (SCHEMA, CHANNEL, MESSAGE):
                found.oversized[offset] = length
            found.is_complete = opcode == DATA_END
        offset = end
    end_run()
    found.lost_bytes = 0 if found.is_complete else size - offset
    return found


def records(data: bytes) -> Iterator[tuple[int, int, int]]:
    """(opcode, begin, end) of the content of each record in ``data``.

    Raises:
        ValueError: a record reaches beyond the end of the data.
    """
    position, size = 0, len(data)
    while position < size:
        if position + HEADER.size > size:
            raise ValueError(f"{size - position} stray bytes after the last record")
        opcode, length = HEADER.unpack_from(data, position)
        position += HEADER.size
        end = position + length
        if end > size or (opcode == MESSAGE and length < MESSAGE_HEADER.size):
            raise ValueError(f"record of {length} bytes does not fit at {position} of {size}")
        yield opcode, position, end
        position = end
