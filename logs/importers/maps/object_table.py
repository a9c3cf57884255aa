"""Objects of a map in a table: CSV with a header, or JSON lines, in metres or in degrees; gzip as well."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from logs.importers.maps.map_objects import MapObjects, check_degrees, distinct
from logs.importers.tables import LENGTH_UNITS, Table, read_table
from logs.importers.text_files import read_source_text

CLASS_NAMES = ("class", "label", "category", "type", "kind", "species")
_UNIQUE_IDS = ("id", "object_id", "uid")
ID_NAMES = (*_UNIQUE_IDS, "name")
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
    heights = table.optional_numbers(height, LENGTH_UNITS) if height is not None else np.zeros(len(table.cells))
    positions = np.column_stack([*plane, np.nan_to_num(heights)])
    if is_geodetic:
        check_degrees(str(path), positions)
    for column in filter(None, (table.find((name,)) for name in _UNIQUE_IDS)):
        cells = table.cells[column.name]
        is_repeated = np.asarray(cells.duplicated() & (cells != ""))
        remedy = "give each object one of its own, or rename the column"
        table.refuse(is_repeated, column, f"'CELL' is taken by an earlier line; {remedy}")
    return MapObjects(str(path), positions, find_labels(table), find_ids(table), is_geodetic, source.sha256)


def find_labels(table: Table) -> tuple[str, ...]:
    """The class (R,) of each row, ``UNKNOWN`` where the table has none."""
    return tuple(cell or UNKNOWN for cell in _first_column(table, CLASS_NAMES))


def find_ids(table: Table) -> tuple[str, ...]:
    """Unique names of rows (R,): those in the table; repeated ones are followed by their place."""
    cells = zip(table.cells.index, _first_column(table, ID_NAMES), strict=True)
    return distinct(cell or f"line {line}" for line, cell in cells)


def _first_column(table: Table, names: tuple[str, ...]) -> tuple[str, ...]:
    """The cells (R,) of the column that bears the first of the names that any does, else empty ones."""
    found = (table.texts((name,)) for name in names)
    return next((cells for cells in found if cells is not None), ("",) * len(table.cells))
