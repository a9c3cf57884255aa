"""Objects of a map in a table: CSV with a header, in metres or in degrees; gzip as well."""

from pathlib import Path

import numpy as np

from logs.importers.maps.map_objects import MapObjects, objects_of
from logs.importers.tables import DEGREES, LENGTH_UNITS, read_table
from logs.importers.text_files import read_source_text


def read_object_table(path: Path) -> MapObjects:
    """Read columns ``x_m, y_m`` (``z_m``), also called easting and northing, or ``lat, lon`` (``altitude_m``), and
    where known ``class`` and ``id``.

    Raises:
        DatasetError: a column that is missing, or a cell that is no number.
    """
    source = read_source_text(path)
    table = read_table(source)
    latitude = table.find(("lat", "latitude"), DEGREES)
    if latitude is not None:
        plane = [latitude, table.need("the longitude", "lon", ("lon", "lng", "longitude"), DEGREES)]
    else:
        plane = [
            table.need(f"{axis} or lat and lon", f"{axis}_m", names, LENGTH_UNITS)
            for axis, names in (("x", ("x", "easting")), ("y", ("y", "northing")))
        ]
    heights = table.lengths(("z", "altitude", "elevation"))
    positions = np.column_stack([*(column.numbers() for column in plane), heights])
    cells = zip(table.lines, table.first_texts(("id", "object_id", "name")), strict=True)
    ids = [cell or f"line {line}" for line, cell in cells]
    return objects_of(table, positions, ids, source.sha256, is_geodetic=latitude is not None)
