"""Points of PCD and PLY files with all their fields.

Open3D crashes on the fields called "_" with which PCL fills gaps in PCD, and ignores unsigned integers in PLY, in which
labels are published. "The PCD file format", Point Cloud Library, version 0.7; Greg Turk, "The PLY polygon file format".
"""

from __future__ import annotations

import os
import struct
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from logs.errors import DatasetError
from logs.storage.regular_file import open_regular

_PCD_TYPES = {"F": (4, 8), "I": (1, 2, 4, 8), "U": (1, 2, 4, 8)}
_PLY_TYPES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4"}
_PLY_TYPES |= {"double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4"}
_PLY_TYPES |= {"uint32": "u4", "float32": "f4", "float64": "f8"}
_PLY_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_FILLING = "_"
_MAX_HEADER_LINES = 1000
_SIZES = struct.Struct("<II")
_MAX_EXPANSION = 100
"""LZF writes at most 264 bytes as three."""


@dataclass(frozen=True, slots=True)
class _Layout:
    """``count`` points of fields called ``names``, each of a type and as many numbers: "ascii", "binary" or "lzf"."""

    names: tuple[str, ...]
    kinds: tuple[np.dtype[Any], ...]
    widths: tuple[int, ...]
    count: int
    storage: str

    @property
    def row(self) -> np.dtype[Any]:
        """The type of a point; fields are called by their places."""
        fields = zip(self.kinds, self.widths, strict=True)
        return np.dtype([(str(i), kind, (width,)) for i, (kind, width) in enumerate(fields)])


def read_points(path: Path) -> Mapping[str, NDArray[Any]]:
    """Name -> values (N,) of the fields of one number a point; a file is PCD by its suffix, else PLY.

    Raises:
        DatasetError: the file cannot be read, is of another format, or is cut off.
    """
    is_pcd = path.suffix.lower() == ".pcd"
    try:
        with open_regular(path) as stream:
            layout = _read_pcd_header(stream) if is_pcd else _read_ply_header(stream)
            columns = _READERS[layout.storage](stream, layout)
    except OSError as error:
        raise DatasetError(f"{path}: cannot be read ({error.strerror}); check the path") from error
    except (ValueError, OverflowError, IndexError, struct.error) as error:
        kind = "PCD" if is_pcd else "PLY"
        raise DatasetError(f"{path}: no {kind} file that can be read ({error}); write it again") from error
    if len(columns[0]) < layout.count:
        raise DatasetError(
            f"{path}: {len(columns[0])} of {layout.count} points are there; it is cut off: copy it again"
        )
    fields = zip(layout.names, layout.widths, columns, strict=True)
    return {name: values[:, 0] for name, width, values in fields if width == 1 and name != _FILLING}


def _read_pcd_header(stream: BinaryIO) -> _Layout:
    entries: dict[str, list[str]] = {}
    for _ in range(_MAX_HEADER_LINES):
        words = stream.readline(10_000).decode("ascii").split()
        if not words and not entries:
            break
        if words and not words[0].startswith("#"):
            entries[words[0]] = words[1:]
        if "DATA" in entries:
            break
    if not {"FIELDS", "SIZE", "TYPE", "WIDTH", "HEIGHT", "DATA"} <= entries.keys():
        raise ValueError("its header lacks FIELDS, SIZE, TYPE, WIDTH, HEIGHT or DATA")
    names, sizes, codes = entries["FIELDS"], [int(size) for size in entries["SIZE"]], entries["TYPE"]
    widths = [int(count) for count in entries.get("COUNT", ["1"] * len(names))]
    if not names or not len(names) == len(sizes) == len(codes) == len(widths):
        raise ValueError("FIELDS, SIZE, TYPE and COUNT differ in length")
    for code, size in zip(codes, sizes, strict=True):
        if size not in _PCD_TYPES.get(code, ()):
            raise ValueError(f"a field of type {code} and size {size}")
    count = int(entries["WIDTH"][0]) * int(entries["HEIGHT"][0])
    storage = {"binary_compressed": "lzf"}.get(" ".join(entries["DATA"]), " ".join(entries["DATA"]))
    if count < 0 or min(widths) < 1 or storage not in _READERS:
        raise ValueError(f"{count} points, COUNT {' '.join(map(str, widths))}, DATA {storage}")
    kinds = tuple(np.dtype(f"<{code.lower()}{size}") for code, size in zip(codes, sizes, strict=True))
    return _checked(_Layout(tuple(names), kinds, tuple(widths), count, storage))


def _read_ply_header(stream: BinaryIO) -> _Layout:
    if stream.readline(16).strip() != b"ply":
        raise ValueError("it does not begin with 'ply'")
    order, count, properties, elements = "", 0, list[tuple[str, str]](), list[str]()
    for _ in range(_MAX_HEADER_LINES):
        words = stream.readline(1000).decode("ascii").split()
        match words:
            case ["end_header"]:
                break
            case ["format", name, _] if name in _PLY_ORDERS:
                order = _PLY_ORDERS[name]
            case ["element", name, number]:
                elements.append(name)
                count = int(number) if len(elements) == 1 else count
            case ["property", code, name] if elements == ["vertex"] and code in _PLY_TYPES:
                properties.append((name, _PLY_TYPES[code]))
            case ["property", *_] if elements == ["vertex"]:
                raise ValueError(f"a vertex has {' '.join(words)!r}, which is not a number")
            case ["comment" | "obj_info" | "property", *_]:
                pass
            case _:
                raise ValueError(f"{' '.join(words)[:60]!r} in its header")
    else:
        raise ValueError("its header has no end")
    if elements[:1] != ["vertex"] or count < 0 or not properties:
        raise ValueError("its first element is not a list of vertices")
    names = tuple(name for name, _ in properties)
    kinds = tuple(np.dtype(order + code) for _, code in properties)
    return _checked(_Layout(names, kinds, (1,) * len(names), count, "binary" if order else "ascii"))


def _checked(layout: _Layout) -> _Layout:
    names = [name for name in layout.names if name != _FILLING]
    if len(set(names)) < len(names):
        raise ValueError("two of its fields have the same name")
    return layout


def _check_size(stream: BinaryIO, count: int, min_bytes: int) -> None:
    """See that the rest of the file has room for ``count`` points, before memory is taken for them; the last byte may
    be left out.
    """
    left = os.fstat(stream.fileno()).st_size - stream.tell() + 1
    if count * min_bytes > left:
        raise ValueError(f"at most {left // min_bytes} of {count} points are there; it is cut off")


def _read_text(stream: BinaryIO, layout: _Layout) -> list[NDArray[Any]]:
    width = sum(layout.widths)
    _check_size(stream, layout.count, 2 * width)
    rows = np.zeros((0, width))
    if layout.count:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # of lines without numbers
            rows = np.loadtxt(stream, max_rows=layout.count, ndmin=2)
    if rows.shape[1] != width:
        raise ValueError(f"lines of {rows.shape[1]} numbers for {width} fields")
    return np.split(rows, np.cumsum(layout.widths)[:-1], axis=1)


def _read_binary(stream: BinaryIO, layout: _Layout) -> list[NDArray[Any]]:
    _check_size(stream, layout.count, layout.row.itemsize)
    rows = np.fromfile(stream, layout.row, layout.count)
    return [rows[name] for name in layout.row.names or ()]


def _read_compressed(stream: BinaryIO, layout: _Layout) -> list[NDArray[Any]]:
    """Each field of all points after the other, packed by LZF."""
    packed_bytes, size = _SIZES.unpack(stream.read(_SIZES.size))
    packed = stream.read(packed_bytes)
    if size != layout.row.itemsize * layout.count or size > _MAX_EXPANSION * len(packed) or len(packed) < packed_bytes:
        raise ValueError(f"{len(packed)} of {packed_bytes} bytes for {layout.count} points; it is cut off")
    content, begin, columns = _unpack(packed, size), 0, list[NDArray[Any]]()
    for kind, width in zip(layout.kinds, layout.widths, strict=True):
        values = np.frombuffer(content, kind, width * layout.count, begin)
        columns.append(values.reshape(layout.count, width))
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
            raise ValueError("its packed data refer to missing data")
        run = content[begin : begin + length + 2]
        content += (run * ((length + 2) // len(run) + 1))[: length + 2]
    if len(content) != size:
        raise ValueError(f"{len(content)} bytes unpacked, not {size}")
    return content


_READERS = {"ascii": _read_text, "binary": _read_binary, "lzf": _read_compressed}
