"""Vertices of a PLY file with all properties. Open3D passes over unsigned integers, in which labels are published.

Greg Turk, "The PLY polygon file format", 1994.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from logs.clouds.file_size import check_size
from logs.clouds.text_rows import read_rows
from logs.errors import DatasetError
from logs.storage.regular_file import open_regular

_TYPES = {
    "char": "i1",
    "uchar": "u1",
    "short": "i2",
    "ushort": "u2",
    "int": "i4",
    "uint": "u4",
    "float": "f4",
    "double": "f8",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "float32": "f4",
    "float64": "f8",
}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_LONGEST_HEADER = 1000


def read_ply(path: Path) -> Mapping[str, NDArray[Any]]:
    """Name -> values (N,) of the properties of the vertices.

    Raises:
        DatasetError: the file cannot be read, is no PLY file, is cut off, or its first element is not "vertex".
    """
    try:
        with open_regular(path) as stream:
            order, count, properties = _header(path, stream)
            names = list(properties)
            kind = np.dtype([(name, order + code) for name, code in properties.items()])
            check_size(stream, count, kind.itemsize if order else 2 * len(names), "vertices")
            if order:
                rows: NDArray[Any] = np.fromfile(stream, kind, count)
                columns: Mapping[str, NDArray[Any]] = {name: rows[name] for name in names}
            else:
                rows = read_rows(stream, count, len(names))
                if rows.shape[1:] != (len(names),):
                    raise ValueError(f"lines of {rows.shape[1]} numbers for {len(names)} properties")
                columns = dict(zip(names, rows.T, strict=True))
    except OSError as error:
        raise DatasetError(f"{path}: cannot be read ({error.strerror}); check the path") from error
    except (ValueError, OverflowError) as error:
        raise DatasetError(f"{path}: no PLY file that can be read ({error}); write it again") from error
    if len(rows) < count:
        raise DatasetError(f"{path}: {len(rows)} of {count} vertices are there; it is cut off: copy it again")
    return columns


def _header(path: Path, stream: BinaryIO) -> tuple[str, int, dict[str, str]]:
    """Byte order ("" for text), number of vertices, and the type of each of their properties."""
    if stream.readline(16).strip() != b"ply":
        raise DatasetError(f"{path}: no PLY file: it does not begin with 'ply'")
    order, count, properties, elements = "", 0, dict[str, str](), list[str]()
    for _ in range(_LONGEST_HEADER):
        words = stream.readline(1000).decode("ascii").split()
        match words:
            case ["end_header"]:
                break
            case ["format", name, _] if name in _ORDERS:
                order = _ORDERS[name]
            case ["element", name, number]:
                elements.append(name)
                count = int(number) if len(elements) == 1 else count
            case ["property", code, name] if elements == ["vertex"] and code in _TYPES and name not in properties:
                properties[name] = _TYPES[code]
            case ["property", _, name] if elements == ["vertex"] and name in properties:
                raise ValueError(f"two properties of a vertex are called {name!r}")
            case ["property", *_] if elements == ["vertex"]:
                raise ValueError(f"a vertex has {' '.join(words)!r}, which is no number")
            case ["comment" | "obj_info" | "property", *_]:
                pass
            case _:
                raise ValueError(f"{' '.join(words)[:60]!r} in its header")
    else:
        raise ValueError("its header has no end")
    if elements[:1] != ["vertex"]:
        raise ValueError("its first element is no vertex")
    if count < 0:
        raise ValueError(f"{count} vertices")
    return order, count, properties
