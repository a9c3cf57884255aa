"""Labelled clouds in PLY files, by the names of their fields.

Open3D ignores unsigned integers in PLY, in which labels are published. Greg Turk, "The PLY polygon file format".
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from logs.clouds.labelled_cloud import LabelledCloud
from logs.errors import DatasetError
from logs.storage.regular_file import open_regular

_PREFIX = "scalar_"
"""CloudCompare puts it before the names of fields."""

_TYPES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4"}
_TYPES |= {"double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4"}
_TYPES |= {"uint32": "u4", "float32": "f4", "float64": "f8"}
_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">"}

CLASS_FIELDS = ("class", "class_id", "classification", "semantic", "semantic_label", "label", "category")
INSTANCE_FIELDS = ("instance", "instance_id", "instance_label", "object_id", "object", "id", "label")
"""Names of the fields that hold a point's class and instance, likeliest first: a "label" is the class, unless another
field is that. So they are in Paris-Lille-3D ("class", "label"; Roynard et al., IJRR 2018) and in IQmulus &
TerraMobilita ("class", "id"; Vallet et al., Computers & Graphics 2015)."""


def labelled_cloud(columns: Mapping[str, NDArray[Any]], name: str) -> LabelledCloud:
    """The cloud of ``columns``, name -> values (N,). ``name`` is what messages call it.

    Where no field tells instances and the classes are those of SemanticKITTI with the instance in their upper half,
    they are taken apart.

    Raises:
        DatasetError: no positions or classes; names the fields.
    """
    plain = {key.lower().removeprefix(_PREFIX): values for key, values in columns.items()}
    there = ", ".join(columns) or "none"
    if not {"x", "y", "z"} <= plain.keys():
        raise DatasetError(f"{name}: no fields x, y and z; it has {there}")
    class_field = _first(plain, CLASS_FIELDS)
    if class_field is None:
        raise DatasetError(f"{name}: no field holds the class of a point ({' or '.join(CLASS_FIELDS)}); it has {there}")
    positions = np.stack([plain[axis].astype(np.float64) for axis in "xyz"], axis=1)
    classes = _whole(plain[class_field], f"{name}: field {class_field}")
    instance_field = _first(plain, [field for field in INSTANCE_FIELDS if field != class_field])
    if instance_field is not None:
        return LabelledCloud(positions, classes, _whole(plain[instance_field], f"{name}: field {instance_field}"))
    if class_field == "label" and len(classes) and classes.max() > 0xFFFF:
        return LabelledCloud(positions, classes & 0xFFFF, classes >> 16)
    return LabelledCloud(positions, classes)


def read_points(path: Path) -> Mapping[str, NDArray[Any]]:
    """Name -> values (N,) of the fields of a point.

    Raises:
        DatasetError: the file cannot be read, is not PLY, or is cut off.
    """
    try:
        with open_regular(path) as stream:
            points = _read_points(stream)
    except OSError as error:
        raise DatasetError(f"{path}: cannot be read ({error.strerror}); check the path") from error
    except (ValueError, OverflowError, IndexError, KeyError) as error:
        raise DatasetError(f"{path}: not a readable binary PLY file ({error}); write it again") from error
    return {name: points[name] for name in points.dtype.names or ()}


def _read_points(stream: BinaryIO) -> NDArray[Any]:
    """The points, of which memory is taken for no more than the file has room for.

    Raises:
        ValueError: it is no PLY file, its first element is not a vertex, or points are missing.
        KeyError: text, or an unknown type of a property.
    """
    head, end, _ = stream.read(100_000).partition(b"end_header")
    lines = [line.split() for line in head.decode("ascii").splitlines() if not line.startswith(("comment", "obj_info"))]
    if not end or lines[0] != ["ply"] or lines[2][:2] != ["element", "vertex"]:
        raise ValueError("it does not begin with a header whose first element is the vertex")
    order, count = _ORDERS[lines[1][1]], int(lines[2][2])
    others = next((i for i, line in enumerate(lines[3:], start=3) if line[:1] != ["property"]), len(lines))
    row = np.dtype([(line[2], order + _TYPES[line[1]]) for line in lines[3:others]])
    stream.seek(len(head) + len(end))
    stream.readline()
    left = os.fstat(stream.fileno()).st_size - stream.tell()
    if not 0 <= count * row.itemsize <= left:
        raise ValueError(f"not all of {count} points are there; the file is truncated")
    return np.fromfile(stream, row, count)


def _first(columns: Mapping[str, NDArray[Any]], names: Sequence[str]) -> str | None:
    return next((name for name in names if name in columns), None)


def _whole(values: NDArray[Any], what: str) -> NDArray[np.int64]:
    if values.dtype.kind == "f" and not (np.isfinite(values) & (values == np.round(values))).all():
        raise DatasetError(f"{what} holds fractions, which cannot be labels; rename the field")
    return values.astype(np.int64)
