"""Points of PLY files with all their fields.

Open3D ignores unsigned integers in PLY, in which labels are published. Greg Turk, "The PLY polygon file format".
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from logs.errors import DatasetError
from logs.storage.regular_file import open_regular

_TYPES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4"}
_TYPES |= {"double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4"}
_TYPES |= {"uint32": "u4", "float32": "f4", "float64": "f8"}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_MAX_HEADER_LINES = 1000


def read_points(path: Path) -> Mapping[str, NDArray[Any]]:
    """Name -> values (N,) of the fields of a point.

    Raises:
        DatasetError: the file cannot be read, is not PLY, or is cut off.
    """
    try:
        with open_regular(path) as stream:
            order, count, fields = _read_header(stream)
            points = _read_rows(stream, count, np.dtype([(name, order + kind) for name, kind in fields]), order)
    except OSError as error:
        raise DatasetError(f"{path}: cannot be read ({error.strerror}); check the path") from error
    except (ValueError, OverflowError, IndexError) as error:
        raise DatasetError(f"{path}: not a readable PLY file ({error}); write it again") from error
    if len(points) < count:
        raise DatasetError(f"{path}: {len(points)} of {count} points are there; the file is truncated, copy it again")
    return {name: points[name] for name in points.dtype.names or ()}


def _read_header(stream: BinaryIO) -> tuple[str, int, list[tuple[str, str]]]:
    """Order of the bytes ("" for text), number of vertices, and name and type of each of their properties.

    Raises:
        ValueError: it is no such header, or that of something else than points.
    """
    if stream.readline(16).strip() != b"ply":
        raise ValueError("it does not begin with 'ply'")
    order, count, properties, elements = "", 0, list[tuple[str, str]](), list[str]()
    for _ in range(_MAX_HEADER_LINES):
        words = stream.readline(1000).decode("ascii").split()
        match words:
            case ["end_header"]:
                break
            case ["format", name, _] if name in _ORDERS:
                order = _ORDERS[name]
            case ["element", name, number]:
                elements.append(name)
                count = int(number) if len(elements) == 1 else count
            case ["property", code, name] if elements == ["vertex"] and code in _TYPES:
                properties.append((name, _TYPES[code]))
            case ["comment" | "obj_info", *_]:
                pass
            case ["property", *_] if elements != ["vertex"]:
                pass
            case _:
                raise ValueError(f"{' '.join(words)[:60]!r} in its header")
    else:
        raise ValueError("its header has no end")
    if elements[:1] != ["vertex"] or count < 0 or not properties:
        raise ValueError("its first element is not a list of vertices")
    return order, count, properties


def _read_rows(stream: BinaryIO, count: int, row: np.dtype[Any], order: str) -> NDArray[Any]:
    """At most ``count`` points, of which memory is taken for no more than the file has room for."""
    names = row.names or ()
    min_bytes = row.itemsize if order else 2 * len(names)
    left = os.fstat(stream.fileno()).st_size - stream.tell() + 1  # the last byte may be left out
    if count * min_bytes > left:
        raise ValueError(f"at most {left // min_bytes} of {count} points are there; the file is truncated")
    if order:
        return np.fromfile(stream, row, count)
    if not count:
        return np.zeros(0, row)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of lines without numbers
        numbers = np.loadtxt(stream, max_rows=count, ndmin=2)
    if numbers.shape[1] != len(names):
        raise ValueError(f"lines of {numbers.shape[1]} numbers for {len(names)} fields")
    return np.rec.fromarrays(list(numbers.T), dtype=[(name, np.float64) for name in names])
