"""Rows under named columns, from CSV with a header or JSON lines; faults are reported with their line and column."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from logs.container.json_text import parse_json
from logs.errors import DatasetError
from logs.importers.text_files import SourceText, is_number
from logs.messages import FloatArray

LENGTH_UNITS: Mapping[str, float] = {"": 1.0, "m": 1.0, "cm": 1e-2, "mm": 1e-3}
"""Suffix of a column -> metres."""
NO_UNITS: Mapping[str, float] = {"": 1.0}

_DELIMITERS = (",", ";", "\t")
_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")


@dataclass(frozen=True, slots=True)
class Column:
    """One column of a table: its name as the file has it, and the unit that the name ends in ("" for none)."""

    name: str
    unit: str


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """Cells as text, ``columns[name][row]``; ``lines`` (R,) is where each row stands in the file."""

    name: str
    columns: Mapping[str, Sequence[str]]
    lines: Sequence[int]

    def find(self, fields: Iterable[str], units: Iterable[str] = ("",)) -> Column | None:
        """The column that bears one of the names ``fields``, followed by one of ``units``; None if there is none.

        Upper and lower case are one, and so are ``x_m``, ``x [m]`` and ``x (m)``.

        Raises:
            DatasetError: several columns do.
        """
        wanted = {f"{field}_{unit}" if unit else field: unit for field in fields for unit in units}
        found = [Column(name, wanted[_plain(name)]) for name in self.columns if _plain(name) in wanted]
        if len(found) > 1:
            names = " and ".join(column.name for column in found)
            raise DatasetError(f"{self.name}: columns {names} have the same meaning; remove or rename all but one")
        return found[0] if found else None

    def need(self, what: str, example: str, fields: Iterable[str], units: Iterable[str] = ("",)) -> Column:
        """Like ``find``, for a column that must be there; ``example`` is the name to give it.

        Raises:
            DatasetError: there is none, or there are several.
        """
        column = self.find(fields, units)
        if column is None:
            there = ", ".join(self.columns)
            raise DatasetError(f"{self.name}: no column for {what} among {there}; call the one that holds it {example}")
        return column

    def numbers(self, column: Column, units: Mapping[str, float] = NO_UNITS) -> FloatArray:
        """The cells (R,) as finite numbers, times the factor in ``units`` of the unit of the column.

        Raises:
            DatasetError: a cell is no finite number.
        """
        values = self.optional_numbers(column, units, remedy="correct or remove the line")
        self.refuse(np.isnan(values), column, "empty; give a number, or remove the line")
        return values

    def optional_numbers(
        self,
        column: Column,
        units: Mapping[str, float] = NO_UNITS,
        *,
        remedy: str = "correct it, or leave it empty if it is not known",
    ) -> FloatArray:
        """Like ``numbers``, but NaN for an empty cell.

        Raises:
            DatasetError: a cell that is not empty is no finite number.
        """
        cells = self.columns[column.name]
        wrong = next((row for row, cell in enumerate(cells) if cell and not is_number(cell)), None)
        if wrong is not None:
            cell = cells[wrong]
            raise self.error(wrong, column, f"{cell!r} is not a finite number; {decimal_remedy(cell, remedy)}")
        return np.array([float(cell or "nan") for cell in cells]) * units[column.unit]

    def refuse(self, wrong: NDArray[np.bool_], column: Column, fault: str) -> None:
        """See that none of the rows is ``wrong`` (R,); in ``fault``, "CELL" stands for the cell of the first that is.

        Raises:
            DatasetError: one is.
        """
        if wrong.any():
            row = int(wrong.argmax())
            raise self.error(row, column, fault.replace("CELL", self.columns[column.name][row], 1))

    def error(self, row: int, columns: Column | str, fault: str) -> DatasetError:
        """What is wrong with a cell (or with several columns of a row), with its place."""
        name = columns if isinstance(columns, str) else columns.name
        return DatasetError(f"{self.name}, line {self.lines[row]}, column {name}: {fault}")


def read_table(source: SourceText) -> Table:
    """The table in ``source``: JSON lines if it begins with a brace, else CSV whose first line names the columns.

    Raises:
        DatasetError: neither of the two, no row, or a row that does not fit the columns.
    """
    start = source.text.lstrip()[:1]
    if start == "[":
        raise DatasetError(f"{source.name}: a JSON array; write one object a line (JSON lines), or CSV with a header")
    table = _read_json_lines(source) if start == "{" else _read_csv(source)
    if not table.lines:
        raise DatasetError(f"{source.name}: no row in it; expected a header and at least one line")
    return table


def table_of_rows(source: SourceText, names: Sequence[str], rows: Iterable[tuple[int, Sequence[str]]]) -> Table:
    """A table of rows of cells, each with its line.

    Raises:
        DatasetError: a row has another number of cells than there are names.
    """
    kept = list(rows)
    wrong = next(((line, len(row)) for line, row in kept if len(row) != len(names)), None)
    if wrong is not None:
        raise DatasetError(
            f"{source.name}, line {wrong[0]}: {wrong[1]} values where {len(names)} are expected ({', '.join(names)})"
        )
    columns = {name: [row[i].strip() for _, row in kept] for i, name in enumerate(names)}
    return Table(source.name, columns, [line for line, _ in kept])


def header_above(source: SourceText, line: int) -> str | None:
    """The comment nearest above ``line`` that may name columns; None for none."""
    above = source.text.splitlines()[: line - 1]
    return next((text for text in reversed(above) if any(delimiter in text for delimiter in _DELIMITERS)), None)


def _read_csv(source: SourceText) -> Table:
    line, first = next(iter(source.lines()), (0, ""))
    if not line:
        raise DatasetError(f"{source.name}: no line in it; expected a header and at least one line")
    above = header_above(source, line) if is_number(re.split(r"[,;\t]", first)[0]) else None
    header = first if above is None else above.strip().lstrip("#")
    lines, delimiter = source.text.splitlines(), max(_DELIMITERS, key=header.count)
    if delimiter not in header:
        header, lines, delimiter = ",".join(header.split()), [",".join(each.split()) for each in lines], ","
    passed = line if above is None else line - 1
    reader = csv.reader([header, *lines[passed:]], delimiter=delimiter)
    try:
        names = [name.strip() for name in next(reader)]
        if not names or is_number(names[0]) or 2 * sum(map(is_number, names)) > len(names):
            raise DatasetError(
                f"{source.name}, line {line}: numbers where the names of the columns are expected; "
                "begin the file with a header such as stamp_s,label,x_m,y_m,z_m"
            )
        twice = next((name for i, name in enumerate(names) if name in names[:i]), None)
        if twice is not None:
            raise DatasetError(f"{source.name}, line {line}: column {twice} stands there twice; rename or remove one")
        rows = ((passed + reader.line_num - 1, row) for row in reader if row and not row[0].lstrip().startswith("#"))
        return table_of_rows(source, names, rows)
    except csv.Error as error:
        raise DatasetError(f"{source.name}, line {passed + reader.line_num - 1}: not CSV ({error})") from error


def _read_json_lines(source: SourceText) -> Table:
    objects: list[tuple[int, dict[str, str]]] = []
    for line, text in source.lines():
        try:
            # Numbers stay text, so that stamps keep all their digits.
            value = parse_json(text, parse_float=str, parse_int=str, parse_constant=str)
        except json.JSONDecodeError as error:
            raise DatasetError(
                f"{source.name}, line {line}: not JSON ({error.msg}, character {error.colno}); write one object a line"
            ) from error
        except ValueError as error:
            raise DatasetError(f"{source.name}, line {line}: {error}; write flat objects, one a line") from error
        if not isinstance(value, dict):
            raise DatasetError(f'{source.name}, line {line}: not an object; write {{"stamp_s": 0.1, "x_m": 1.0, ...}}')
        objects.append((line, {key: _cell(source, line, key, cell) for key, cell in value.items()}))
    names = list(dict.fromkeys(name for _, value in objects for name in value))
    return table_of_rows(source, names, ((line, [value.get(name, "") for name in names]) for line, value in objects))


def _cell(source: SourceText, line: int, key: str, value: object) -> str:
    if value is None or isinstance(value, str):
        return value or ""
    raise DatasetError(
        f"{source.name}, line {line}, column {key}: {json.dumps(value)[:40]} is neither a number nor a text; "
        "write each number under a name of its own, such as x_m, y_m and z_m"
    )


def decimal_remedy(cell: str, otherwise: str) -> str:
    """What to do about a cell that is no number: a decimal comma is one for a point."""
    return "write numbers with a decimal point" if _DECIMAL_COMMA.fullmatch(cell) else otherwise


def _plain(name: str) -> str:
    """The name in the form in which columns are compared."""
    return "_".join(re.findall(r"[a-z0-9]+", name.lower()))
