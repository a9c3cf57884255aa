"""Rows under named columns; faults are reported with their line and column."""

import csv
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import field
from decimal import Decimal

import numpy as np
from numpy.typing import NDArray

from logs.errors import DatasetError
from logs.importers.text_files import SourceText
from logs.messages import FloatArray, IntArray
from logs.records import frozen
from logs.validation import LAST_NS

LENGTH_UNITS: Mapping[str, float] = {"": 1.0, "m": 1.0, "cm": 1e-2, "mm": 1e-3}
"""Suffix of a column -> metres."""
DEGREES: Mapping[str, float] = {"": 1.0, "deg": 1.0}
NO_UNITS: Mapping[str, float] = {"": 1.0}

LABEL_NAMES = ("label", "class", "class_name", "category", "kind", "species", "type", "class_id", "category_id", "name")
"""Names of the column with the class of an object, likeliest first."""

UNLABELLED = "object"
"""Class of objects that have none."""

_DELIMITERS = ",;\t"

STAMP_NAMES = ("stamp", "timestamp", "time", "t")
TIME_UNITS: Mapping[str, float] = {"": 1e9, "s": 1e9, "ms": 1e6, "us": 1e3, "ns": 1.0}
"""Suffix of a column -> nanoseconds; without a suffix, seconds."""

UNIT_REMEDY = "name the column by its unit: stamp_s, stamp_ms, stamp_us or stamp_ns"
_DATE = re.compile(r"\d{4}(-?)\d\d\1\d\d[T ]\d\d:?\d\d")


@frozen
class Column:
    """One column of the table in a file: its cells (R,) as text, the lines (R,) of their rows, and the factor of the
    unit that its name ends in.
    """

    file: str
    lines: Sequence[int]
    name: str
    cells: Sequence[str]
    scale: float

    def numbers(self, empty: float | None = None) -> FloatArray:
        """The cells (R,) as finite numbers in the unit that all have, ``empty`` where a cell is empty.

        Raises:
            DatasetError: a cell is no finite number, or it is empty and nothing stands for it.
        """
        is_empty = np.array([cell == "" for cell in self.cells], dtype=np.bool_)
        values = np.array([float(cell) if is_number(cell) else math.nan for cell in self.cells])
        fault = "'CELL' is not a finite number; write it with a decimal point, or leave it empty"
        self.refuse(np.isnan(values) & ~is_empty, fault)
        if empty is None:
            self.refuse(is_empty, "empty; give a number, or remove the line")
        else:
            values[is_empty] = empty
        return values * self.scale

    def refuse(self, wrong: NDArray[np.bool_], fault: str) -> None:
        """See that none of the rows is ``wrong`` (R,); in ``fault``, "CELL" stands for the cell of the first that is.

        Raises:
            DatasetError: one is.
        """
        if wrong.any():
            row = int(wrong.argmax())
            raise self.error(row, fault.replace("CELL", self.cells[row][:40], 1))

    def error(self, row: int, fault: str) -> DatasetError:
        """What is wrong with the cell in a row, with its place."""
        return DatasetError(f"{self.file}, line {self.lines[row]}, column {self.name}: {fault}")


@frozen
class Table:
    """The cells (R,) of each column as text, and the ``lines`` (R,) of the rows in the file ``name``.

    ``used`` collects the names of the columns that were found.
    """

    name: str
    lines: Sequence[int]
    columns: Mapping[str, Sequence[str]]
    used: set[str] = field(default_factory=set)

    def find(self, fields: Iterable[str], units: Mapping[str, float] = NO_UNITS) -> Column | None:
        """The column that bears one of the names ``fields``, followed by one of ``units``; None if there is none.

        Upper and lower case are one, and so are ``x_m``, ``x [m]`` and ``x (m)``.

        Raises:
            DatasetError: several columns do.
        """
        wanted = {f"{field}_{unit}".rstrip("_"): scale for field in fields for unit, scale in units.items()}
        plain = {name: "_".join(re.findall(r"[a-z0-9]+", name.lower())) for name in self.columns}
        found = [name for name in self.columns if plain[name] in wanted]
        if len(found) > 1:
            names = " and ".join(found)
            raise DatasetError(f"{self.name}: columns {names} have the same meaning; remove or rename all but one")
        self.used.update(found)
        return self._column(found[0], wanted[plain[found[0]]]) if found else None

    def need(self, what: str, example: str, fields: Iterable[str], units: Mapping[str, float] = NO_UNITS) -> Column:
        """Like ``find``, for a column that must be there; ``example`` is the name to give it.

        Raises:
            DatasetError: there is none, or there are several.
        """
        column = self.find(fields, units)
        if column is None:
            there = ", ".join(self.columns)
            raise DatasetError(f"{self.name}: no column for {what} among {there}; name the one that holds it {example}")
        return column

    def first_texts(self, names: Iterable[str]) -> Sequence[str]:
        """The cells (R,) of the column that bears the first of the names whose cells are not all empty; all are empty
        where there is no such column.
        """
        named = filter(None, (self.find((name,)) for name in names))
        return next(filter(any, (column.cells for column in named)), [""] * len(self.lines))

    def lengths(self, names: Iterable[str]) -> FloatArray:
        """The lengths (R,) m in the column that bears one of the names; 0 where a cell or the column is missing.

        Raises:
            DatasetError: a cell is no number, or there are several such columns.
        """
        column = self.find(names, LENGTH_UNITS)
        return np.zeros(len(self.lines)) if column is None else column.numbers(empty=0.0)

    def matrix(self) -> FloatArray:
        """All cells (R, C) as finite numbers, of a table of nothing else.

        Raises:
            DatasetError: a cell is no finite number.
        """
        return np.stack([self._column(name, 1.0).numbers() for name in self.columns], axis=1)

    def stamps(self, *, strictly: bool) -> IntArray:
        """The stamps (R,) [ns] of the rows, in the order of time, exact to the nanosecond.

        Raises:
            DatasetError: no row, no column of stamps or several, a cell that is no time from 0 on, or a stamp that is
                before the one of the row before or, if ``strictly``, equal to it.
        """
        column = self.need("the stamp", "stamp_s", STAMP_NAMES, TIME_UNITS)
        if not self.lines:
            raise DatasetError(f"{self.name} has no rows; expected at least one line with a stamp")
        stamps_ns = np.empty(len(self.lines), dtype=np.int64)
        for row, cell in enumerate(column.cells):
            try:
                stamps_ns[row] = _nanoseconds(cell, int(column.scale))
            except ValueError as error:
                raise column.error(row, f"{cell[:40]!r} is {error}; correct it, or {UNIT_REMEDY}") from error
        steps = np.diff(stamps_ns, prepend=stamps_ns[:1] - 1)
        column.refuse(steps < 0, "CELL comes after a later stamp; sort the lines by this column")
        twice = "CELL occurs twice; remove one of the two lines, or write the stamps with more digits"
        column.refuse(strictly & (steps == 0), twice)
        return stamps_ns

    def _column(self, name: str, scale: float) -> Column:
        return Column(self.name, self.lines, name, self.columns[name], scale)


def read_table(source: SourceText, names: Sequence[str] = ()) -> Table:
    """The lines of ``source`` that are neither blank nor comments (#), split at commas, semicolons, tabs or blanks.

    Args:
        source: the file.
        names: of its columns; without them, the first line has the names.

    Raises:
        DatasetError: no header, a name that occurs twice, or a line that does not fit the columns.
    """
    rows = [*_rows(source)]
    if not names:
        if not rows or any(map(is_number, rows[0][1])):
            raise DatasetError(
                f"{source.name} does not begin with the names of its columns; begin it with a header such as "
                "stamp_s,label,x_m,y_m,z_m"
            )
        names = rows.pop(0)[1]
    twice = next((name for i, name in enumerate(names) if name in names[:i]), None)
    if twice is not None:
        raise DatasetError(f"{source.name}: column {twice} occurs twice; rename or remove one")
    for number, row in rows:
        if len(row) != len(names):
            raise DatasetError(
                f"{source.name}, line {number}: {len(row)} values where {len(names)} are expected ({', '.join(names)})"
            )
    columns = {name: [row[i] for _, row in rows] for i, name in enumerate(names)}
    return Table(source.name, [number for number, _ in rows], columns)


def first_row(source: SourceText) -> list[str]:
    """The cells of the first line that is neither blank nor a comment.

    Raises:
        DatasetError: there is no such line.
    """
    for _, row in _rows(source):
        return row
    raise DatasetError(f"{source.name} is empty; expected at least one line")


def _rows(source: SourceText) -> Iterator[tuple[int, list[str]]]:
    """Number and cells of each line that is neither blank nor a comment; the first line tells the delimiter.

    Raises:
        DatasetError: a line that is not CSV.
    """
    lines = source.lines()
    header = lines[0][1] if lines else ""
    delimiter = max(filter(header.count, _DELIMITERS), key=header.count, default=" ")
    for number, line in lines:
        text = " ".join(line.split()) if delimiter == " " else line
        try:
            cells = next(csv.reader([text], delimiter=delimiter, skipinitialspace=True))
        except csv.Error as error:
            raise DatasetError(f"{source.name}, line {number}: not CSV ({error})") from error
        yield number, [cell.strip() for cell in cells]


def is_number(text: str) -> bool:
    """Whether ``text`` is a finite number."""
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


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
