"""Rows under named columns; faults are reported with their line and column."""

import csv
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from logs.errors import DatasetError
from logs.importers.text_files import SourceText
from logs.messages import FloatArray
from logs.records import frozen

LENGTH_UNITS: Mapping[str, float] = {"": 1.0, "m": 1.0, "cm": 1e-2, "mm": 1e-3}
"""Suffix of a column -> metres."""
NO_UNITS: Mapping[str, float] = {"": 1.0}

LABEL_NAMES = ("label", "class", "class_name", "category", "kind", "species", "type", "class_id", "category_id", "name")
"""Names of the column with the class of an object, likeliest first."""

UNLABELLED = "object"
"""Class of objects that have none."""

_DELIMITERS = ",;\t"


@frozen
class Column:
    """One column of a table: its name as the file has it, and the factor of the unit that the name ends in."""

    name: str
    scale: float


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
        found = [Column(name, wanted[plain[name]]) for name in self.columns if plain[name] in wanted]
        if len(found) > 1:
            names = " and ".join(column.name for column in found)
            raise DatasetError(f"{self.name}: columns {names} have the same meaning; remove or rename all but one")
        self.used.update(column.name for column in found)
        return found[0] if found else None

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
        """The cells (R,) of the column that bears the first of the names whose cells are not all empty."""
        named = filter(None, (self.find((name,)) for name in names))
        return next(filter(any, (self.columns[column.name] for column in named)), [""] * len(self.lines))

    def labels(self) -> Sequence[str]:
        """The classes (R,) of the rows, empty where a cell is, or where there is no such column."""
        return self.first_texts(LABEL_NAMES)

    def numbers(self, column: Column) -> FloatArray:
        """The cells (R,) as finite numbers in the unit that all have.

        Raises:
            DatasetError: a cell is no finite number.
        """
        values = self.optional_numbers(column)
        self.refuse(np.isnan(values), column, "empty; give a number, or remove the line")
        return values

    def optional_numbers(self, column: Column) -> FloatArray:
        """Like ``numbers``, but NaN for an empty cell.

        Raises:
            DatasetError: a cell that is not empty is no finite number.
        """
        cells = self.columns[column.name]
        values = np.array([float(cell) if is_number(cell) else math.nan for cell in cells])
        wrong = np.isnan(values) & np.array([cell != "" for cell in cells], dtype=np.bool_)
        self.refuse(wrong, column, "'CELL' is not a finite number; write it with a decimal point, or leave it empty")
        return values * column.scale

    def matrix(self) -> FloatArray:
        """All cells (R, C) as finite numbers, of a table of nothing else.

        Raises:
            DatasetError: a cell is no finite number.
        """
        return np.stack([self.numbers(Column(name, 1.0)) for name in self.columns], axis=1)

    def refuse(self, wrong: NDArray[np.bool_], column: Column, fault: str) -> None:
        """See that none of the rows is ``wrong`` (R,); in ``fault``, "CELL" stands for the cell of the first that is.

        Raises:
            DatasetError: one is.
        """
        if wrong.any():
            row = int(wrong.argmax())
            raise self.error(row, column.name, fault.replace("CELL", self.columns[column.name][row][:40], 1))

    def error(self, row: int, columns: str, fault: str) -> DatasetError:
        """What is wrong with a cell (or with several columns of a row), with its place."""
        return DatasetError(f"{self.name}, line {self.lines[row]}, column {columns}: {fault}")


def read_table(source: SourceText, names: Sequence[str] = ()) -> Table:
    """The lines of ``source`` that are neither blank nor comments (#), split at commas, semicolons, tabs or blanks.

    Args:
        source: the file.
        names: of its columns; without them, the first line has the names.

    Raises:
        DatasetError: no header, a name that occurs twice, or a line that does not fit the columns.
    """
    lines = source.lines()
    delimiter = _delimiter(lines[0][1]) if lines else ""
    rows = [_split(source, number, line, delimiter) for number, line in lines]
    if not names:
        if not rows or any(map(is_number, rows[0])):
            raise DatasetError(
                f"{source.name} does not begin with the names of its columns; begin it with a header such as "
                "stamp_s,label,x_m,y_m,z_m"
            )
        names, rows, lines = rows[0], rows[1:], lines[1:]
    twice = next((name for i, name in enumerate(names) if name in names[:i]), None)
    if twice is not None:
        raise DatasetError(f"{source.name}: column {twice} occurs twice; rename or remove one")
    for (number, _), row in zip(lines, rows, strict=True):
        if len(row) != len(names):
            raise DatasetError(
                f"{source.name}, line {number}: {len(row)} values where {len(names)} are expected ({', '.join(names)})"
            )
    columns = {name: [row[i] for row in rows] for i, name in enumerate(names)}
    return Table(source.name, [number for number, _ in lines], columns)


def first_row(source: SourceText) -> list[str]:
    """The cells of the first line that is neither blank nor a comment.

    Raises:
        DatasetError: there is no such line.
    """
    number, line = next(iter(source.lines()), (0, ""))
    if not line:
        raise DatasetError(f"{source.name} is empty; expected at least one line")
    return _split(source, number, line, _delimiter(line))


def _delimiter(line: str) -> str:
    delimiter = max(_DELIMITERS, key=line.count)
    return delimiter if delimiter in line else " "


def _split(source: SourceText, number: int, line: str, delimiter: str) -> list[str]:
    text = " ".join(line.split()) if delimiter == " " else line
    try:
        return [cell.strip() for cell in next(csv.reader([text], delimiter=delimiter, skipinitialspace=True))]
    except csv.Error as error:
        raise DatasetError(f"{source.name}, line {number}: not CSV ({error})") from error


def is_number(text: str) -> bool:
    """Whether ``text`` is a finite number."""
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False
