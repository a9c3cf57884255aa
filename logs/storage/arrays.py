"""Arrays attached to an MCAP file, in NumPy's file format, mapped into memory."""

import zlib
from collections.abc import Collection
from pathlib import Path
from tokenize import TokenError
from typing import Any, BinaryIO, Literal

import numpy as np
from mcap.records import AttachmentIndex
from numpy.typing import NDArray

from logs.errors import UnreadableLogError
from logs.storage.mcap_index import DAMAGE, HEADER, read_summary

_NO_HEADER = (TypeError, SyntaxError, TokenError)  # NumPy reads a header as an expression of Python


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
            summary = read_summary(stream)
            if summary is None:
                raise UnreadableLogError(f"{path} is damaged: it ends early")
            for place in summary[AttachmentIndex]:
                if place.name in checked:
                    content = np.memmap(
                        path, np.uint8, "r", place.offset + HEADER.size, place.length - HEADER.size
                    ).data
                    # The checksum of an attachment follows it; 0 stands for none.
                    if int.from_bytes(content[-4:], "little") not in (0, zlib.crc32(content[:-4])):
                        raise UnreadableLogError(f"{path} is damaged: array {place.name} has another checksum")
                found[place.name] = _map_array(path, stream, place)
    except (*DAMAGE, *_NO_HEADER, OSError) as error:
        raise UnreadableLogError(f"{path} is damaged: an attachment cannot be read as an array ({error})") from error
    return found


def _map_array(path: Path, stream: BinaryIO, place: AttachmentIndex) -> NDArray[Any]:
    """The content of an attachment, mapped into memory.

    Raises:
        ValueError: it is no array in NumPy's format, or one of objects, or longer than the attachment.
    """
    end = place.offset + place.length - 4  # of the checksum
    stream.seek(end - place.data_size)
    np.lib.format.read_magic(stream)
    shape, is_fortran, dtype = np.lib.format.read_array_header_1_0(stream)
    begin, size = stream.tell(), int(np.prod(shape, dtype=object)) * dtype.itemsize
    if dtype.hasobject or begin + size > end:
        raise ValueError(f"array {place.name[:40]!r} of {dtype} and shape {shape}")
    order: Literal["F", "C"] = "F" if is_fortran else "C"
    return np.memmap(path, dtype, "r", begin, shape, order) if size else np.zeros(shape, dtype)
