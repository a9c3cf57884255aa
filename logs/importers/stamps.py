"""Times in text files, in one of several units, exact to the nanosecond."""

import re
from collections.abc import Mapping
from decimal import Decimal

import numpy as np

from logs.errors import DatasetError
from logs.importers.tables import Table
from logs.messages import IntArray
from logs.validation import LAST_NS

STAMP_NAMES = ("stamp", "timestamp", "time", "t")
TIME_UNITS: Mapping[str, float] = {"": 1e9, "s": 1e9, "ms": 1e6, "us": 1e3, "ns": 1.0}
"""Suffix of a column -> nanoseconds; without a suffix, seconds."""

UNIT_REMEDY = "name the column by its unit: stamp_s, stamp_ms, stamp_us or stamp_ns"
_DATE = re.compile(r"\d{4}(-?)\d\d\1\d\d[T ]\d\d:?\d\d")


def read_stamps(table: Table, *, strictly: bool) -> IntArray:
    """The stamps (R,) [ns] of the rows of ``table``, in the order of time.

    Raises:
        DatasetError: no row, no column of stamps or several, a cell that is no time from 0 on, or a stamp that is
            before the one of the row before or, if ``strictly``, equal to it.
    """
    column = table.need("the stamp", "stamp_s", STAMP_NAMES, TIME_UNITS)
    if not table.lines:
        raise DatasetError(f"{table.name} has no rows; expected at least one line with a stamp")
    stamps_ns = np.empty(len(table.lines), dtype=np.int64)
    for row, cell in enumerate(table.columns[column.name]):
        try:
            stamps_ns[row] = _nanoseconds(cell, int(column.scale))
        except ValueError as error:
            raise table.error(row, column.name, f"{cell[:40]!r} is {error}; correct it, or {UNIT_REMEDY}") from error
    steps = np.diff(stamps_ns, prepend=stamps_ns[:1] - 1)
    table.refuse(steps < 0, column, "CELL comes after a later stamp; sort the lines by this column")
    twice = "CELL occurs twice; remove one of the two lines, or write the stamps with more digits"
    table.refuse(strictly & (steps == 0), column, twice)
    return stamps_ns


def _nanoseconds(cell: str, unit_ns: int) -> int:
    """Nanoseconds of a number of units of ``unit_ns``, or of a date as ISO 8601 and pandas write it.

    Raises:
        ValueError: it is no time that a log can hold.
    """
    try:
        if _DATE.match(cell):
            import pandas as pd

            exact = Decimal(pd.Timestamp(cell).as_unit("ns").value)  # in UTC where it names no zone
        else:
            exact = Decimal(cell) * unit_ns
    except (ValueError, ArithmeticError) as error:
        raise ValueError("not a time") from error
    if not exact.is_finite():
        raise ValueError("not a time")
    if exact < 0:
        raise ValueError("before 0, which no log can hold")
    if exact > LAST_NS:
        raise ValueError("a time after the year 2116")
    if unit_ns == 1 and exact != exact.to_integral_value():
        raise ValueError("not whole nanoseconds")
    return int(exact.to_integral_value())
