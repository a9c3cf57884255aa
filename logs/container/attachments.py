"""Arrays attached to an MCAP file, in NumPy's file format, mapped into memory."""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from tokenize import TokenError
from typing import Any, BinaryIO, Literal

import numpy as np
from numpy.typing import NDArray

from logs.blocks import HEADER
from logs.container.file_index import DAMAGE, IndexedFile
from logs.container.limits import ReadingLimits
from logs.errors import UnreadableLogError

_TIMES, _LENGTH, _LONG_LENGTH, _CHECKSUM = (struct.Struct(each) for each in ("<QQ", "<I", "<Q", "<I"))
OVERHEAD = HEADER.size + _TIMES.size + 2 * _LENGTH.size + _LONG_LENGTH.size
"""Bytes of an attachment before its content, without those of its name and its media type."""
_LONGEST_TEXT = 1000
_NO_HEADER = (TypeError, SyntaxError, TokenError)  # NumPy reads a header as an expression of Python
_PIECE_BYTES = 1 << 20


@dataclass(frozen=True, slots=True)
class Attachment:
    """An attachment with the content [begin, end) of the file; ``checked_from``: where what is checked begins."""

    name: str
    begin: int
    end: int
    checked_from: int

    def is_intact(self, stream: BinaryIO) -> bool:
        """Whether the content has the checksum that follows it; 0 stands for none."""
        stream.seek(self.checked_from)
        checksum = 0
        left = self.end - self.checked_from
        while left > 0 and (data := stream.read(min(left, _PIECE_BYTES))):
            checksum = zlib.crc32(data, checksum)
            left -= len(data)
        (written,) = _CHECKSUM.unpack(stream.read(_CHECKSUM.size))
        return left == 0 and written in (0, checksum)

    def map_array(self, path: Path, stream: BinaryIO) -> NDArray[Any]:
        """The content, an array in NumPy's format, mapped into memory.

        Raises:
            ValueError: it is none, or one of objects, or longer than the attachment.
        """
        stream.seek(self.begin)
        np.lib.format.read_magic(stream)
        shape, is_fortran, dtype = np.lib.format.read_array_header_1_0(stream)
        begin, size = stream.tell(), int(np.prod(shape, dtype=object)) * dtype.itemsize
        if dtype.hasobject or begin + size > self.end:
            raise ValueError(f"array {self.name[:40]!r} of {dtype} and shape {shape}")
        order: Literal["F", "C"] = "F" if is_fortran else "C"
        return np.memmap(path, dtype, "r", begin, shape, order) if size else np.zeros(shape, dtype)


def read_arrays(path: Path, *, checked: Collection[str] = ()) -> dict[str, NDArray[Any]]:
    """The arrays attached to a file, by name: of each only the pages that are used are read.

    Args:
        path: an MCAP file.
        checked: names of those that are read once now and compared with their checksums.

    Raises:
        UnreadableLogError: the file ends early, an attachment is no array, or one that is checked is damaged.
    """
    found = {}
    try:
        with path.open("rb") as stream:
            index = IndexedFile(str(path), stream, path.stat().st_size, ReadingLimits()).index
            if not index.is_complete:
                raise UnreadableLogError(f"{path} is damaged: it ends early")
            for offset in index.attachment_offsets:
                attachment = _attachment_at(stream, offset)
                if attachment.name in checked and not attachment.is_intact(stream):
                    raise UnreadableLogError(f"{path} is damaged: array {attachment.name} has another checksum")
                found[attachment.name] = attachment.map_array(path, stream)
    except (*DAMAGE, *_NO_HEADER, OSError) as error:
        raise UnreadableLogError(f"{path} is damaged: an attachment cannot be read as an array ({error})") from error
    return found


def _attachment_at(stream: BinaryIO, offset: int) -> Attachment:
    """The attachment whose record begins at ``offset``.

    Raises:
        struct.error: the file ends before.
        ValueError: its name is too long.
    """
    stream.seek(offset)
    HEADER.unpack(stream.read(HEADER.size))
    stream.seek(_TIMES.size, os.SEEK_CUR)
    texts = []
    for _ in ("name", "media type"):
        (length,) = _LENGTH.unpack(stream.read(_LENGTH.size))
        if length > _LONGEST_TEXT:
            raise ValueError(f"a name of {length} bytes")
        texts.append(stream.read(length))
    (length,) = _LONG_LENGTH.unpack(stream.read(_LONG_LENGTH.size))
    begin = stream.tell()
    return Attachment(texts[0].decode(errors="replace"), begin, begin + length, offset + HEADER.size)
