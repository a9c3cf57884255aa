"""Times in text files: exact to the nanosecond, in one of several units or as dates (ISO 8601)."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from logs.importers.tables import Column, Table
from logs.messages import IntArray

STAMP_NAMES = ("stamp", "timestamp", "time", "t")
TIME_UNITS: Mapping[str, int] = {"": 9, "s": 9, "ms": 6, "us": 3, "ns": 0}
"""Suffix of a column -> power of ten that makes nanoseconds of it; without a suffix, seconds."""

UNIT_REMEDY = "call the column by its unit: stamp_s, stamp_ms, stamp_us or stamp_ns"
_LAST_NS = 2**63 - 1
_DATE = re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d\S* ?\S*")


@dataclass(frozen=True, slots=True, eq=False)
class Stamps:
    """``stamps_ns`` (R,) of the rows of a table, and their ``column``."""

    table: Table
    column: Column
    stamps_ns: IntArray

    def check_increasing(self, *, strictly: bool) -> None:
        """See that the rows are in the order of time.

        Raises:
            DatasetError: a stamp is before the one of the row before or, if ``strictly``, equal to it.
        """
        steps = np.diff(self.stamps_ns, prepend=self.stamps_ns[:1] - 1)
        self.table.refuse(steps < 0, self.column, "CELL comes after a later stamp; sort the lines by this column")
        twice = "CELL occurs twice; remove one of the two lines, or write the stamps with more digits"
        self.table.refuse(strictly & (steps == 0), self.column, twice)


def read_stamps(table: Table) -> Stamps:
    """The stamps of ``table``, exact to the nanosecond.

    Raises:
        DatasetError: no column of stamps or several, or a cell that is no time from 0 on.
    """
    column = table.need("the stamp", "stamp_s", STAMP_NAMES, TIME_UNITS)
    stamps_ns = np.empty(len(table.cells), dtype=np.int64)
    for row, cell in enumerate(table.cells[column.name]):
        try:
            stamps_ns[row] = _date_ns(cell) if _DATE.fullmatch(cell) else _number_ns(cell, TIME_UNITS[column.unit])
        except (ValueError, InvalidOperation) as error:
            reason = "not a time" if isinstance(error, InvalidOperation) else error
            raise table.error(row, column.name, f"{cell[:40]!r} is {reason}; correct it, or {UNIT_REMEDY}") from error
    return Stamps(table, column, stamps_ns)


def _date_ns(cell: str) -> int:
    """Nanoseconds of a date and time, in UTC unless it names an offset.

    Raises:
        ValueError: there is no such time.
    """
    date = pd.Timestamp(cell).as_unit("ns")
    stamp_ns = int((date.tz_localize("UTC") if date.tz is None else date).value)
    if stamp_ns < 0:
        raise ValueError("before 1970")
    return stamp_ns


def _number_ns(cell: str, unit: int) -> int:
    """Nanoseconds of a number of which one is 10 to the power of ``unit`` nanoseconds.

    Raises:
        InvalidOperation: it is no number.
        ValueError: it is no time that a log can hold.
    """
    exact = Decimal(cell)
    if not exact.is_finite():
        raise ValueError("not a time")
    if exact < 0:
        raise ValueError("before 0, which no log can hold")
    if unit == 0 and exact != exact.to_integral_value():
        raise ValueError("not whole nanoseconds")
    if exact > Decimal(_LAST_NS).scaleb(-unit):  # the other way round, an exponent might overflow
        raise ValueError("a time after the year 2262")
    return int(exact.scaleb(unit).to_integral_value())


def match_clock(stamps: Stamps, odometry: Stamps) -> NDArray[np.bool_]:
    """Which rows (R,) lie in the time of the odometry.

    Raises:
        DatasetError: fewer than half of them do: another unit or another clock.
    """
    first_ns, last_ns = int(odometry.stamps_ns[0]), int(odometry.stamps_ns[-1])
    inside = (stamps.stamps_ns >= first_ns) & (stamps.stamps_ns <= last_ns)
    if 2 * np.count_nonzero(inside) < len(inside):
        stamps.table.refuse(
            ~inside,
            stamps.column,
            f"CELL and {np.count_nonzero(~inside) - 1} more of {len(inside)} stamps are outside the odometry's time; "
            f"{odometry.table.name} lasts from {first_ns * 1e-9:.9g} s to {last_ns * 1e-9:.9g} s; give both by one "
            f"clock, or {UNIT_REMEDY}",
        )
    return np.asarray(inside)
