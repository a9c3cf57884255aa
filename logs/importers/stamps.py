"""Times as text files tell them: exact, in one of several units, rounded to as many digits as were written."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation

import numpy as np
from numpy.typing import NDArray

from logs.importers.tables import Column, Table, decimal_remedy
from logs.messages import FloatArray, IntArray

STAMP_NAMES = ("stamp", "timestamp", "time", "t")
TIME_UNITS: Mapping[str, int] = {"": 9, "s": 9, "ms": 6, "us": 3, "ns": 0}
"""Suffix of a column -> power of ten that makes nanoseconds of it; a column that says nothing holds seconds."""

_UNIT_NAMES = {9: "seconds", 6: "milliseconds", 3: "microseconds", 0: "nanoseconds"}
_SUFFIXES = {9: "s", 6: "ms", 3: "us", 0: "ns"}
_LAST_NS = 2**63 - 1
_LEAST_SHARE_OF_TIME = 0.01
"""Of the odometry's time that detections last. In a unit that is a thousand times too small they last less."""
_FIRST_EPOCH_S, _LAST_EPOCH_S = 10**9, 4 * 10**9  # 2001 to 2096: what clocks of robots tell, counted from 1970


@dataclass(frozen=True, slots=True, eq=False)
class Stamps:
    """``stamps_ns`` (R,) of the rows of a table.

    ``resolution_ns``: one unit of the last digit that the file writes, at least what doubles of that size resolve.
    """

    table: Table
    column: Column
    stamps_ns: IntArray
    resolution_ns: int

    @property
    def unit(self) -> int:
        """Power of ten that makes nanoseconds of the column."""
        return TIME_UNITS[self.column.unit]

    @property
    def unit_name(self) -> str:
        """Name of the unit of the column."""
        return _UNIT_NAMES[self.unit]

    def check_increasing(self, *, strictly: bool) -> None:
        """See that the rows are in the order of time.

        Raises:
            DatasetError: a stamp is before the one of the row before or, if ``strictly``, equal to it.
        """
        steps = np.diff(self.stamps_ns)
        wrong = np.flatnonzero(steps <= 0 if strictly else steps < 0)
        if len(wrong) == 0:
            return
        row = int(wrong[0]) + 1
        cells = self.table.columns[self.column.name]
        if steps[row - 1] == 0:
            fault = (
                f"{cells[row]} stands there twice; remove one of the two lines, or write the stamps with more digits"
            )
        else:
            fault = f"{cells[row]} comes after {cells[row - 1]}; sort the lines by this column"
        raise self.table.error(row, self.column, fault)


def read_stamps(table: Table) -> Stamps:
    """The stamps of ``table``, exact to the nanosecond.

    Raises:
        DatasetError: no column of stamps or several, or a cell that is no time from 0 on.
    """
    column = table.need("the stamp", "stamp_s", STAMP_NAMES, TIME_UNITS)
    unit = TIME_UNITS[column.unit]
    known: dict[str, int] = {}
    finest = unit
    stamps_ns = np.zeros(len(table.lines), dtype=np.int64)
    for row, cell in enumerate(table.columns[column.name]):
        stamp_ns = known.get(cell)
        if stamp_ns is None:
            exact = _decimal(table, row, column, cell)
            finest = min(finest, unit + int(exact.as_tuple().exponent))
            stamp_ns = known[cell] = int(exact.scaleb(unit).to_integral_value())
        stamps_ns[row] = stamp_ns
    written_ns = 10 ** max(finest, 0)
    double_ns = int(np.ceil(np.spacing(float(stamps_ns.max()))))
    return Stamps(table, column, stamps_ns, max(written_ns, double_ns))


def match_clock(stamps: Stamps, odometry: Stamps) -> NDArray[np.bool_]:
    """Which rows (R,) lie in the time of the odometry, give or take how both files round.

    Raises:
        DatasetError: fewer than half of them do: another unit or another clock.
    """
    first_ns, last_ns = int(odometry.stamps_ns[0]), int(odometry.stamps_ns[-1])
    # Each file rounds by at most half a unit of its last digit.
    tolerance_ns = (stamps.resolution_ns + odometry.resolution_ns + 1) // 2
    inside = _within(stamps.stamps_ns, first_ns - tolerance_ns, last_ns + tolerance_ns)
    if 2 * np.count_nonzero(inside) >= len(inside):
        return inside
    row = int(np.flatnonzero(~inside)[0])
    spans = f"the odometry ({odometry.table.name}) lasts from {first_ns * 1e-9:.9g} s to {last_ns * 1e-9:.9g} s"
    raise stamps.table.error(
        row,
        stamps.column,
        f"{stamps.table.columns[stamps.column.name][row]} and {np.count_nonzero(~inside) - 1} more of {len(inside)} "
        f"stamps are outside the odometry's time; {spans}; {_clock_remedy(stamps, first_ns, last_ns)}",
    )


def snap_to_span(stamps_ns: IntArray, inside: NDArray[np.bool_], odometry: Stamps) -> IntArray:
    """The stamps (R,), of which those that rounding alone put before the odometry's first or after its last are it."""
    first_ns, last_ns = odometry.stamps_ns[0], odometry.stamps_ns[-1]
    return np.where(inside, np.clip(stamps_ns, first_ns, last_ns), stamps_ns)


def _within(stamps_ns: IntArray | FloatArray, first_ns: int, last_ns: int) -> NDArray[np.bool_]:
    return np.asarray((stamps_ns >= first_ns) & (stamps_ns <= last_ns))


def _clock_remedy(stamps: Stamps, first_ns: int, last_ns: int) -> str:
    """A unit in which most stamps are in the odometry's time and, if they differ at all, fill a good part of it."""
    duration_ns = float(np.ptp(stamps.stamps_ns))
    for unit, name in _UNIT_NAMES.items():
        scale = 10.0 ** (unit - stamps.unit)
        scaled = stamps.stamps_ns.astype(np.float64) * scale
        if 0.0 < duration_ns * scale < _LEAST_SHARE_OF_TIME * (last_ns - first_ns):
            continue
        if unit != stamps.unit and 2 * np.count_nonzero(_within(scaled, first_ns, last_ns)) >= len(scaled):
            return f"the column seems to hold {name}: call it stamp_{_SUFFIXES[unit]}"
    return "give both by one clock; if one of them counts from the start of the drive, add that time to its stamps"


def _decimal(table: Table, row: int, column: Column, cell: str) -> Decimal:
    try:
        exact = Decimal(cell)
    except InvalidOperation:
        exact = Decimal("nan")
    if not exact.is_finite():
        remedy = decimal_remedy(cell, "correct or remove the line")
        raise table.error(row, column, f"{cell!r} is not a time; {remedy}")
    unit = TIME_UNITS[column.unit]
    if exact < 0:
        raise table.error(row, column, f"{cell} is before 0, which no log can hold; add a constant to all stamps")
    if unit == 0 and exact != exact.to_integral_value():
        raise table.error(
            row,
            column,
            f"{cell} are no whole nanoseconds; name the columns and call this one stamp_s if it holds seconds",
        )
    if exact <= Decimal(_LAST_NS).scaleb(-unit):  # the other way round, an exponent might overflow
        return exact
    epochs = [
        u for u in (6, 3, 0) if u < unit and _FIRST_EPOCH_S * 10 ** (9 - u) <= exact <= _LAST_EPOCH_S * 10 ** (9 - u)
    ]
    remedy = f"they look like {_UNIT_NAMES[epochs[0]]}: " if epochs else ""
    raise table.error(
        row,
        column,
        f"{cell} {_UNIT_NAMES[unit]} is a time after the year 2262; {remedy}write seconds, or name the columns and "
        f"call this one {'stamp_' + _SUFFIXES[epochs[0]] if epochs else 'by its unit: stamp_ms, stamp_us or stamp_ns'}",
    )
