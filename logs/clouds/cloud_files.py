"""Labelled point clouds of whole places in PLY files, and the objects of a map in them.

Open3D ignores unsigned integers in PLY, in which labels are published. Greg Turk, "The PLY polygon file format".
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from logs.clouds.labelled_cloud import labelled_cloud
from logs.clouds.objects import find_objects
from logs.digest import file_sha256
from logs.errors import DatasetError
from logs.importers.maps.map_objects import MapObjects
from logs.storage.regular_file import open_regular

_TYPES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4"}
_TYPES |= {"double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4"}
_TYPES |= {"uint32": "u4", "float32": "f4", "float64": "f8"}
_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">"}


def read_cloud_map(path: Path, names: Mapping[int, str] | None = None) -> MapObjects:
    """Objects in a PLY file of the classes in ``names``, or, without it, of all but 0, named by their numbers.

    Raises:
        DatasetError: the file cannot be read, or holds no labels, fewer than four objects, or points too far apart.
    """
    cloud = labelled_cloud(read_points(path), str(path))
    try:
        found = find_objects(cloud, names)
    except DatasetError as error:
        raise DatasetError(f"{path}: {error}") from error
    if len(found.labels) < 4:
        numbers = np.unique(cloud.classes).tolist()
        raise DatasetError(
            f"{path}: {len(found.labels)} objects; a map needs at least four. The classes of its points: "
            f"{', '.join(map(str, numbers[:10])) or 'none'}{', ...' if len(numbers) > 10 else ''}"
        )
    instances = found.instances.tolist()
    ids = tuple(f"{i}" if instance == 0 else f"{instance}:{i}" for i, instance in enumerate(instances))
    return MapObjects(str(path), found.positions, found.labels, ids, False, file_sha256(path))


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
