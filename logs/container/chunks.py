"""A chunk of an MCAP file, decompressed into no more memory than it says and than is allowed."""

from __future__ import annotations

import struct
import zlib
from typing import BinaryIO

import lz4.frame
import zstandard

from logs import blocks

_SIZES = struct.Struct(
    "<QQQII"
)  # first and last log time, size when decompressed, its checksum, length of what follows
_LENGTH = struct.Struct("<Q")
_LONGEST_NAME = 16


class OversizedChunkError(ValueError):
    """A chunk holds more than is allowed; ``size`` in bytes, decompressed."""

    def __init__(self, size: int) -> None:
        super().__init__(f"{size} bytes")
        self.size = size


def read_chunk(stream: BinaryIO, block: blocks.Block, max_bytes: int) -> bytes:
    """The records of the chunk ``block``, its checksum compared.

    Raises:
        OversizedChunkError: it says that it holds, or it holds, more than ``max_bytes``; nothing is decompressed then.
        ValueError: it is damaged, or holds another number of bytes than it says.
    """
    stream.seek(block.offset)
    head = stream.read(blocks.HEADER.size + _SIZES.size + _LONGEST_NAME + _LENGTH.size)
    opcode, length = blocks.HEADER.unpack_from(head)
    if opcode != blocks.CHUNK or length + blocks.HEADER.size != block.length:
        raise ValueError(f"no chunk of {block.length} bytes at {block.offset}")
    _, _, size, checksum, name_length = _SIZES.unpack_from(head, blocks.HEADER.size)
    if name_length > _LONGEST_NAME:
        raise ValueError(f"name of a compression of {name_length} bytes")
    start = blocks.HEADER.size + _SIZES.size
    compression = head[start : start + name_length]
    (stored,) = _LENGTH.unpack_from(head, start + name_length)
    start += name_length + _LENGTH.size
    if start + stored > block.length:
        raise ValueError(f"{stored} bytes do not fit into a chunk of {block.length}")
    if max(size, stored) > max_bytes:
        raise OversizedChunkError(max(size, stored))
    stream.seek(block.offset + start)
    data = _decompressed(stream.read(stored), compression, size)
    if checksum != 0 and zlib.crc32(data) != checksum:
        raise ValueError(f"checksum of the chunk at {block.offset}")
    return data


def _decompressed(data: bytes, compression: bytes, size: int) -> bytes:
    match compression:
        case b"":
            return data
        case b"zstd":
            found = _decompress_zstd(data, size)
        case b"lz4":
            found = _decompress_lz4(data, size)
        case _:
            raise ValueError(f"unknown compression {compression!r}")
    if len(found) != size:
        raise ValueError(f"{len(found)} bytes, not {size}")
    return found


def _decompress_zstd(data: bytes, size: int) -> bytes:
    told = zstandard.get_frame_parameters(data).content_size
    if told not in (size, zstandard.CONTENTSIZE_UNKNOWN):  # else the library would believe the frame
        raise ValueError(f"a frame of {told} bytes in a chunk of {size}")
    return zstandard.ZstdDecompressor().decompress(data, max_output_size=max(size, 1))


def _decompress_lz4(data: bytes, size: int) -> bytes:
    found = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1)
    return bytes(found)
