"""Fixes of a satellite receiver from a table of named columns."""

import numpy as np

from logs.importers.stamps import read_stamps
from logs.importers.tables import LENGTH_UNITS, Table
from logs.messages import FloatArray, GeodeticFix

_DEGREES = {"": 1.0, "deg": 1.0}


def read_fixes(table: Table) -> list[GeodeticFix]:
    """The fixes of ``table``, one a row; the altitude is 0 where it is missing, ``sigma_m`` is of each coordinate.

    Raises:
        DatasetError: a column is missing or stands there twice, a cell is wrong, or the stamps are not in order.
    """
    stamps_ns = read_stamps(table, strictly=False)
    latitudes = _angles(table, "latitude", "lat", 90.0)
    longitudes = _angles(table, "longitude", "lon", 180.0)
    altitudes = _lengths(table, ("altitude", "alt", "height"))
    sigmas = _lengths(table, ("sigma",))
    covariances = [sigma**2 * np.eye(3) if sigma > 0.0 else None for sigma in sigmas.tolist()]
    cells = zip(
        stamps_ns.tolist(), latitudes.tolist(), longitudes.tolist(), altitudes.tolist(), covariances, strict=True
    )
    return [GeodeticFix(stamp_ns, "gnss", *fix) for stamp_ns, *fix in cells]


def _angles(table: Table, name: str, short: str, largest_deg: float) -> FloatArray:
    column = table.need(f"the {name}", f"{name}_deg", (name, short), _DEGREES)
    values = table.numbers(column)
    table.refuse(np.abs(values) > largest_deg, column, f"CELL is no {name} in degrees; write it in decimal degrees")
    return values


def _lengths(table: Table, names: tuple[str, ...]) -> FloatArray:
    """Zeros where the column or a cell is missing."""
    column = table.find(names, LENGTH_UNITS)
    return np.zeros(len(table.lines)) if column is None else np.nan_to_num(table.optional_numbers(column))
