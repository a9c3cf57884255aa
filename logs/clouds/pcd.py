"""Points of a PCD file with all fields. Open3D crashes on the fields called "_" with which PCL fills gaps.

"The PCD file format", Point Cloud Library, version 0.7.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from logs.clouds.file_size import check_size
from logs.clouds.text_rows import read_rows
from logs.errors import DatasetError
from logs.storage.regular_file import open_regular

_TYPES = {"F": ("f", (4, 8)), "I": ("i", (1, 2, 4, 8)), "U": ("u", (1, 2, 4, 8))}
_FILLING = "_"
_LONGEST_HEADER = 100
_SIZES = struct.Struct("<II")
_MOST_EXPANSION = 100
"""LZF writes at most 264 bytes as three."""


@dataclass(frozen=True, slots=True)
class _Header:
    """``kinds``: the type of each field, in their order, of one point; ``count`` points; ``storage``: how they are."""

    names: tuple[str, ...]
    kinds: tuple[np.dtype[Any], ...]
    counts: tuple[int, ...]
    count: int
    storage: str

    @property
    def row(self) -> np.dtype[Any]:
        """The type of a point; fields are called by their places."""
        fields = zip(self.kinds, self.counts, strict=True)
        return np.dtype([(str(i), kind, (count,)) for i, (kind, count) in enumerate(fields)])


def read_pcd(path: Path) -> Mapping[str, NDArray[Any]]:
    """Name -> values (N,) of the fields of one number a point.

    Raises:
        DatasetError: the file cannot be read, is no PCD file, or is cut off.
    """
    try:
        with open_regular(path) as stream:
            header = _read_header(stream)
            columns = _READERS[header.storage](stream, header)
    except OSError as error:
        raise DatasetError(f"{path}: cannot be read ({error.strerror}); check the path") from error
    except (ValueError, OverflowError, IndexError, struct.error) as error:
        raise DatasetError(f"{path}: no PCD file that can be read ({error}); write it again") from error
    if len(columns[0]) < header.count:
        raise DatasetError(
            f"{path}: {len(columns[0])} of {header.count} points are there; it is cut off: copy it again"
        )
    fields = zip(header.names, header.counts, columns, strict=True)
    return {name: values[:, 0] for name, count, values in fields if count == 1 and name != _FILLING}


def _read_header(stream: BinaryIO) -> _Header:
    entries: dict[str, list[str]] = {}
    for _ in range(_LONGEST_HEADER):
        words = stream.readline(10_000).decode("ascii").split()
        if not words and not entries:
            break
        if words and not words[0].startswith("#"):
            entries[words[0]] = words[1:]
        if "DATA" in entries:
            break
    if not {"FIELDS", "SIZE", "TYPE", "WIDTH", "HEIGHT", "DATA"} <= entries.keys():
        raise ValueError("its header lacks FIELDS, SIZE, TYPE, WIDTH, HEIGHT or DATA")
    names, sizes = entries["FIELDS"], [int(size) for size in entries["SIZE"]]
    counts = [int(count) for count in entries.get("COUNT", ["1"] * len(names))]
    if len(set(names) - {_FILLING}) < len([name for name in names if name != _FILLING]):
        raise ValueError("two of its FIELDS have one name")
    if not names or not len(names) == len(sizes) == len(entries["TYPE"]) == len(counts):
        raise ValueError("FIELDS, SIZE, TYPE and COUNT differ in length")
    count = int(entries["WIDTH"][0]) * int(entries["HEIGHT"][0])
    storage = " ".join(entries["DATA"])
    if count < 0 or min(counts) < 1 or storage not in _READERS:
        raise ValueError(f"{count} points, COUNT {' '.join(map(str, counts))}, DATA {storage}")
    kinds = tuple(_kind(code, size) for code, size in zip(entries["TYPE"], sizes, strict=True))
    return _Header(tuple(names), kinds, tuple(counts), count, storage)


def _kind(code: str, size: int) -> np.dtype[Any]:
    letter, sizes = _TYPES.get(code, ("", ()))
    if size not in sizes:
        raise ValueError(f"a field of type {code} and size {size}")
    return np.dtype(f"<{letter}{size}")


def _read_text(stream: BinaryIO, header: _Header) -> list[NDArray[Any]]:
    width = sum(header.counts)
    check_size(stream, header.count, 2 * width, "points")
    rows = read_rows(stream, header.count, width)
    if rows.shape[1] != width and len(rows):
        raise ValueError(f"lines of {rows.shape[1]} numbers for {width} fields")
    ends = np.cumsum(header.counts)
    return [rows[:, end - count : end] for end, count in zip(ends, header.counts, strict=True)]


def _read_binary(stream: BinaryIO, header: _Header) -> list[NDArray[Any]]:
    check_size(stream, header.count, header.row.itemsize, "points")
    rows = np.fromfile(stream, header.row, header.count)
    return [rows[name] for name in header.row.names or ()]


def _read_compressed(stream: BinaryIO, header: _Header) -> list[NDArray[Any]]:
    """Each field of all points after the other, packed by LZF."""
    packed_bytes, size = _SIZES.unpack(stream.read(_SIZES.size))
    check_size(stream, packed_bytes, 1, "packed bytes")
    packed = stream.read(packed_bytes)
    if size != header.row.itemsize * header.count or size > _MOST_EXPANSION * packed_bytes:
        raise ValueError(f"{packed_bytes} bytes packed of {size} for {header.count} points")
    content, begin, columns = _unpack(packed, size), 0, list[NDArray[Any]]()
    for kind, count in zip(header.kinds, header.counts, strict=True):
        values = np.frombuffer(content, kind, count * header.count, begin)
        columns.append(values.reshape(header.count, count))
        begin += values.nbytes
    return columns


def _unpack(packed: bytes, size: int) -> bytearray:
    """What LZF (Marc Lehmann) packed: runs of new bytes, and runs that stand there already, some bytes back."""
    content, at = bytearray(), 0
    while at < len(packed):
        control = packed[at]
        at += 1
        if control < 32:
            content += packed[at : at + control + 1]
            at += control + 1
            continue
        length = control >> 5
        if length == 7:
            length += packed[at]
            at += 1
        begin = len(content) - ((control & 31) << 8) - packed[at] - 1
        at += 1
        if begin < 0:
            raise ValueError("its packed data refer to what is not there")
        run = content[begin : begin + length + 2]
        content += (run * ((length + 2) // len(run) + 1))[: length + 2]
    if len(content) != size:
        raise ValueError(f"{len(content)} bytes unpacked, not {size}")
    return content


_READERS = {"ascii": _read_text, "binary": _read_binary, "binary_compressed": _read_compressed}
