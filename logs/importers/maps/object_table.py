"""Objects of a map in a table: CSV with a header, or JSON lines, in metres or in degrees; gzip as well."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from logs.errors import DatasetError
from logs.importers.maps.map_objects import MapObjects, check_degrees, distinct
from logs.importers.tables import LENGTH_UNITS, Table, read_table
from logs.importers.text_files import read_source_text

CLASS_NAMES = ("class", "label", "category", "type", "kind", "species")
ID_NAMES = ("id", "object_id", "uid", "name")
_MAY_REPEAT = "name"
_AXES = {"x": ("x", "easting", "east"), "y": ("y", "northing", "north")}
DEGREES = {"": 1.0, "deg": 1.0}
UNKNOWN = "object"


def read_object_table(path: Path) -> MapObjects:
    """Read columns ``x_m, y_m`` (``z_m``), also called easting and northing, or ``lat, lon`` (``altitude_m``), and
    where known ``class`` and ``id``.

    Raises:
        DatasetError: a column that is missing, a cell that is no number, or an id that occurs twice.
    """
    source = read_source_text(path)
    table = read_table(source)
    latitude = table.find(("lat", "latitude"), DEGREES)
    is_geodetic = latitude is not None
    if latitude is not None:
        longitude = table.need("the longitude", "lon", ("lon", "lng", "long", "longitude"), DEGREES)
        plane = [table.numbers(latitude, DEGREES), table.numbers(longitude, DEGREES)]
        height = table.find(("alt", "altitude", "height", "elevation"), LENGTH_UNITS)
    else:
        plane = [
            table.numbers(table.need(f"{axis} or lat and lon", f"{axis}_m", names, LENGTH_UNITS), LENGTH_UNITS)
            for axis, names in _AXES.items()
        ]
        height = table.find(("z",), LENGTH_UNITS)
    rows = len(table.cells)
    heights = table.optional_numbers(height, LENGTH_UNITS) if height is not None else np.zeros(rows)
    positions = np.column_stack([*plane, np.nan_to_num(heights)])
    if is_geodetic:
        check_degrees(str(path), positions)
    return MapObjects(str(path), positions, _labels(table, rows), _ids(table, rows), is_geodetic, source.sha256)


def _labels(table: Table, rows: int) -> tuple[str, ...]:
    name = _first_column(table, CLASS_NAMES)
    return tuple(cell or UNKNOWN for cell in table.cells[name]) if name else (UNKNOWN,) * rows


def _ids(table: Table, rows: int) -> tuple[str, ...]:
    name = _first_column(table, ID_NAMES)
    if name is None:
        return tuple(str(row) for row in range(rows))
    ids = [cell or f"line {line}" for line, cell in zip(table.cells.index, table.cells[name], strict=True)]
    if name.lower() == _MAY_REPEAT:
        return distinct(ids)
    first_line: dict[str, int] = {}
    for line, each in zip(table.cells.index, ids, strict=True):
        if first_line.setdefault(each, line) != line:
            raise DatasetError(
                f"{table.name}, line {line}: {name} {each!r} is taken by line {first_line[each]}; give each object "
                "one of its own, or rename the column"
            )
    return tuple(first_line)


def _first_column(table: Table, names: tuple[str, ...]) -> str | None:
    """Name of the column that bears the first of the names that any does."""
    found = (table.find((name,)) for name in names)
    return next((column.name for column in found if column is not None), None)
