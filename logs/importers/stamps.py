"""Times in text files: exact to the nanosecond, in one of several units or as dates (ISO 8601)."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation

import numpy as np
from numpy.typing import NDArray

from logs.importers.tables import Column, Table, decimal_remedy
from logs.messages import IntArray

STAMP_NAMES = ("stamp", "timestamp", "time", "t")
TIME_UNITS: Mapping[str, int] = {"": 9, "s": 9, "ms": 6, "us": 3, "ns": 0}
"""Suffix of a column -> power of ten that makes nanoseconds of it; without a suffix, seconds."""

_UNITS = {9: ("s", "seconds"), 6: ("ms", "milliseconds"), 3: ("us", "microseconds"), 0: ("ns", "nanoseconds")}
_LAST_NS = 2**63 - 1
_MIN_SHARE_OF_TIME = 0.01
"""Of the odometry's time that detections last. In a unit that is a thousand times too small they last less."""
_FIRST_EPOCH_NS, _LAST_EPOCH_NS = 10**18, 4 * 10**18  # 2001 to 2096: what clocks of robots show, counted from 1970
_DATE = re.compile(r"(\d{4}-\d\d-\d\d)[T ](\d\d:\d\d(?::\d\d(?:\.(\d{1,9}))?)?) ?(?:Z|UTC|([+-]\d\d):?(\d\d))?")


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
    def unit_name(self) -> str:
        """Name of the unit of the column."""
        return _UNITS[TIME_UNITS[self.column.unit]][1]

    def cell(self, row: int) -> str:
        """The stamp of a row as the file has it."""
        return self.table.columns[self.column.name][row]

    def check_increasing(self, *, strictly: bool) -> None:
        """See that the rows are in the order of time.

        Raises:
            DatasetError: a stamp is before the one of the row before or, if ``strictly``, equal to it.
        """
        steps = np.diff(self.stamps_ns)
        wrong = np.flatnonzero(steps <= 0 if strictly else steps < 0)
        if not len(wrong):
            return
        row = int(wrong[0]) + 1
        fault = f"{self.cell(row)} comes after {self.cell(row - 1)}; sort the lines by this column"
        if steps[row - 1] == 0:
            fault = f"{self.cell(row)} occurs twice; remove one of the two lines, or write the stamps with more digits"
        raise self.table.error(row, self.column, fault)


def read_stamps(table: Table) -> Stamps:
    """The stamps of ``table``, exact to the nanosecond.

    Raises:
        DatasetError: no column of stamps or several, or a cell that is no time from 0 on.
    """
    column = table.need("the stamp", "stamp_s", STAMP_NAMES, TIME_UNITS)
    known: dict[str, tuple[int, int]] = {}
    for row, cell in enumerate(table.columns[column.name]):
        if cell not in known:
            known[cell] = _date_ns(cell) or _number_ns(table, row, column, cell)
    stamps_ns = np.array([known[cell][0] for cell in table.columns[column.name]], dtype=np.int64)
    written_ns = 10 ** max(min(exponent for _, exponent in known.values()), 0)
    double_ns = int(np.ceil(np.spacing(float(stamps_ns.max()))))
    return Stamps(table, column, stamps_ns, max(written_ns, double_ns))


def _date_ns(cell: str) -> tuple[int, int] | None:
    """Nanoseconds of a date and time, in UTC unless it names an offset, and the power of ten of its last digit."""
    match = _DATE.fullmatch(cell)
    if match is None:
        return None
    date, time, fraction, hours, minutes = match.groups()
    try:
        utc_ns = int(np.datetime64(f"{date}T{time}", "ns").astype(np.int64))
    except ValueError:  # the 30th of February
        return None
    offset_min = int(hours or 0) * 60 + int(minutes or 0) * (-1 if (hours or "").startswith("-") else 1)
    stamp_ns = utc_ns - offset_min * 60 * 10**9
    return (stamp_ns, 9 - len(fraction or "")) if stamp_ns >= 0 else None


def _number_ns(table: Table, row: int, column: Column, cell: str) -> tuple[int, int]:
    """Nanoseconds of a number in the unit of its column, and the power of ten of its last digit."""
    try:
        exact = Decimal(cell)
    except InvalidOperation:
        exact = Decimal("nan")
    unit = TIME_UNITS[column.unit]
    if not exact.is_finite():
        fault = f"{cell!r} is not a time; {decimal_remedy(cell, 'correct or remove the line')}"
    elif exact < 0:
        fault = f"{cell} is before 0, which no log can hold; add a constant to all stamps"
    elif unit == 0 and exact != exact.to_integral_value():
        fault = f"{cell} are not whole nanoseconds; name the columns and call this one stamp_s if it holds seconds"
    elif exact > Decimal(_LAST_NS).scaleb(-unit):  # the other way round, an exponent might overflow
        fault = f"{cell} {_UNITS[unit][1]} is a time after the year 2262; {_epoch_remedy(exact, unit)}"
    else:
        return int(exact.scaleb(unit).to_integral_value()), unit + int(exact.as_tuple().exponent)
    raise table.error(row, column, fault)


def _epoch_remedy(exact: Decimal, unit: int) -> str:
    """The unit in which a time is one that clocks of robots show."""
    for finer in (6, 3, 0):
        epochs = Decimal(_FIRST_EPOCH_NS).scaleb(-finer), Decimal(_LAST_EPOCH_NS).scaleb(-finer)
        if finer < unit and epochs[0] <= exact <= epochs[1]:
            suffix, name = _UNITS[finer]
            return f"they look like {name}: write seconds, or name the columns and call this one stamp_{suffix}"
    return "write seconds, or name the columns and call this one by its unit: stamp_ms, stamp_us or stamp_ns"


def match_clock(stamps: Stamps, odometry: Stamps) -> NDArray[np.bool_]:
    """Which rows (R,) lie in the time of the odometry, give or take how both files round.

    Raises:
        DatasetError: fewer than half of them do: another unit or another clock.
    """
    first_ns, last_ns = int(odometry.stamps_ns[0]), int(odometry.stamps_ns[-1])
    # Each file rounds by at most half a unit of its last digit.
    tolerance_ns = (stamps.resolution_ns + odometry.resolution_ns + 1) // 2
    inside = (stamps.stamps_ns >= first_ns - tolerance_ns) & (stamps.stamps_ns <= last_ns + tolerance_ns)
    if 2 * np.count_nonzero(inside) >= len(inside):
        return np.asarray(inside)
    row = int(inside.argmin())
    spans = f"the odometry ({odometry.table.name}) lasts from {first_ns * 1e-9:.9g} s to {last_ns * 1e-9:.9g} s"
    raise stamps.table.error(
        row,
        stamps.column,
        f"{stamps.cell(row)} and {np.count_nonzero(~inside) - 1} more of {len(inside)} "
        f"stamps are outside the odometry's time; {spans}; {_clock_remedy(stamps, first_ns, last_ns)}",
    )


def snap_to_span(stamps_ns: IntArray, inside: NDArray[np.bool_], odometry: Stamps) -> IntArray:
    """The stamps (R,); those that only rounding puts before the odometry's first or after its last become that."""
    return np.where(inside, np.clip(stamps_ns, odometry.stamps_ns[0], odometry.stamps_ns[-1]), stamps_ns)


def _clock_remedy(stamps: Stamps, first_ns: int, last_ns: int) -> str:
    """A unit in which most stamps are in the odometry's time and, if they differ at all, fill a good part of it."""
    for unit, (suffix, name) in _UNITS.items():
        scaled = stamps.stamps_ns * 10.0 ** (unit - TIME_UNITS[stamps.column.unit])
        is_too_short = 0.0 < np.ptp(scaled) < _MIN_SHARE_OF_TIME * (last_ns - first_ns)
        if not is_too_short and 2 * np.count_nonzero((scaled >= first_ns) & (scaled <= last_ns)) >= len(scaled):
            return f"the column seems to hold {name}: call it stamp_{suffix}"
    return "give both by one clock; if one of them counts from the start of the drive, add that time to its stamps"
