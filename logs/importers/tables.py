"""Rows under named columns, from CSV or JSON lines; faults are reported with their line and column."""

from __future__ import annotations

import csv
import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from logs.container.json_text import parse_json
from logs.errors import DatasetError
from logs.importers.text_files import SourceText, is_number
from logs.messages import FloatArray

LENGTH_UNITS: Mapping[str, float] = {"": 1.0, "m": 1.0, "cm": 1e-2, "mm": 1e-3}
"""Suffix of a column -> metres."""
NO_UNITS: Mapping[str, float] = {"": 1.0}

_DELIMITERS = (",", ";", "\t")


@dataclass(frozen=True, slots=True)
class Column:
    """One column of a table: its name as the file has it, and the unit that the name ends in ("" for none)."""

    name: str
    unit: str


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """``cells`` (R, C) as text; their index is the line of each row in the file ``name``.

    ``used`` collects the names of the columns that were found.
    """

    name: str
    cells: pd.DataFrame
    used: set[str] = field(default_factory=set)

    def find(self, fields: Iterable[str], units: Iterable[str] = ("",)) -> Column | None:
        """The column that bears one of the names ``fields``, followed by one of ``units``; None if there is none.

        Upper and lower case are one, and so are ``x_m``, ``x [m]`` and ``x (m)``.

        Raises:
            DatasetError: several columns do.
        """
        wanted = {f"{field}_{unit}" if unit else field: unit for field in fields for unit in units}
        plain = {name: "_".join(re.findall(r"[a-z0-9]+", name.lower())) for name in self.cells}
        found = [Column(name, wanted[plain[name]]) for name in self.cells if plain[name] in wanted]
        if len(found) > 1:
            names = " and ".join(column.name for column in found)
            raise DatasetError(f"{self.name}: columns {names} have the same meaning; remove or rename all but one")
        self.used.update(column.name for column in found)
        return found[0] if found else None

    def need(self, what: str, example: str, fields: Iterable[str], units: Iterable[str] = ("",)) -> Column:
        """Like ``find``, for a column that must be there; ``example`` is the name to give it.

        Raises:
            DatasetError: there is none, or there are several.
        """
        column = self.find(fields, units)
        if column is None:
            there = ", ".join(self.cells)
            raise DatasetError(f"{self.name}: no column for {what} among {there}; call the one that holds it {example}")
        return column

    def texts(self, fields: Iterable[str]) -> tuple[str, ...] | None:
        """The cells (R,) of the column that bears one of the names; None without such a column."""
        column = self.find(fields)
        return None if column is None else tuple(self.cells[column.name])

    def numbers(self, column: Column, units: Mapping[str, float] = NO_UNITS) -> FloatArray:
        """The cells (R,) as finite numbers, times the factor in ``units`` of the unit of the column.

        Raises:
            DatasetError: a cell is no finite number.
        """
        values = self.optional_numbers(column, units)
        self.refuse(np.isnan(values), column, "empty; give a number, or remove the line")
        return values

    def optional_numbers(self, column: Column, units: Mapping[str, float] = NO_UNITS) -> FloatArray:
        """Like ``numbers``, but NaN for an empty cell.

        Raises:
            DatasetError: a cell that is not empty is no finite number.
        """
        cells = self.cells[column.name]
        values = np.array([float(cell) if is_number(cell) else math.nan for cell in cells])
        wrong = np.isnan(values) & (cells != "").to_numpy()
        self.refuse(wrong, column, "'CELL' is not a finite number; write it with a decimal point, or leave it empty")
        return values * units[column.unit]

    def refuse(self, wrong: NDArray[np.bool_], column: Column, fault: str) -> None:
        """See that none of the rows is ``wrong`` (R,); in ``fault``, "CELL" stands for the cell of the first that is.

        Raises:
            DatasetError: one is.
        """
        if wrong.any():
            row = int(wrong.argmax())
            raise self.error(row, column.name, fault.replace("CELL", self.cells[column.name].iloc[row][:40], 1))

    def error(self, row: int, columns: str, fault: str) -> DatasetError:
        """What is wrong with a cell (or with several columns of a row), with its place."""
        return DatasetError(f"{self.name}, line {self.cells.index[row]}, column {columns}: {fault}")


@dataclass(frozen=True, slots=True)
class Rows:
    """Lines of a file split into cells; ``header``: the names of the columns, None where the file has none."""

    name: str
    header: list[str] | None
    delimiter: str
    lines: list[int]
    cells: list[list[str]]

    def table(self, names: Sequence[str]) -> Table:
        """The rows under the ``names`` of their columns.

        Raises:
            DatasetError: no row, a name that occurs twice, or a row with another number of cells than there are names.
        """
        if not self.lines:
            raise DatasetError(f"{self.name} has no rows; expected a header and at least one line")
        twice = next((name for i, name in enumerate(names) if name in names[:i]), None)
        if twice is not None:
            raise DatasetError(f"{self.name}: column {twice} occurs twice; rename or remove one")
        for line, row in zip(self.lines, self.cells, strict=True):
            if len(row) != len(names):
                raise DatasetError(
                    f"{self.name}, line {line}: {len(row)} values where {len(names)} are expected ({', '.join(names)})"
                )
        return Table(self.name, pd.DataFrame(self.cells, index=self.lines, columns=list(names), dtype=object))


def read_table(source: SourceText) -> Table:
    """The table in ``source``: JSON lines if it begins with a brace, else CSV whose first line names the columns.

    Raises:
        DatasetError: neither of the two, no row, or a row that does not fit the columns.
    """
    start = source.text.lstrip()[:1]
    if start == "[":
        raise DatasetError(f"{source.name}: a JSON array; write one object per line (JSON lines), or CSV with a header")
    if start == "{":
        return _read_json_lines(source)
    rows = read_rows(source)
    if rows.header is None:
        raise DatasetError(
            f"{source.name}, line {rows.lines[0]}: numbers where the names of the columns are expected; begin the file "
            "with a header such as stamp_s,label,x_m,y_m,z_m"
        )
    return rows.table(rows.header)


def read_rows(source: SourceText) -> Rows:
    """The lines of ``source`` that are neither blank nor comments (#), split at commas, semicolons, tabs or blanks.

    The header is the first of them if it holds names, else the comment nearest above it that is split likewise.

    Raises:
        DatasetError: no line, or one that is not CSV.
    """
    start, first = next(iter(source.lines()), (0, ""))
    if not start:
        raise DatasetError(f"{source.name} is empty; expected a header and at least one line")
    delimiter = max(_DELIMITERS, key=first.count)
    lines = source.text.splitlines()
    if delimiter not in first:
        delimiter, lines = " ", [" ".join(line.split()) for line in lines]
    reader = csv.reader(lines[start - 1 :], delimiter=delimiter, skipinitialspace=True)
    numbers, cells = list[int](), list[list[str]]()
    try:
        for row in reader:
            if "".join(row).strip() and not row[0].startswith("#"):
                numbers.append(start - 1 + reader.line_num)
                cells.append([cell.strip() for cell in row])
    except csv.Error as error:
        raise DatasetError(f"{source.name}, line {start - 1 + reader.line_num}: not CSV ({error})") from error
    if is_number(cells[0][0]) or 2 * sum(map(is_number, cells[0])) > len(cells[0]):
        above = next((line for line in reversed(lines[: start - 1]) if delimiter != " " and delimiter in line), None)
        names = above.strip().lstrip("#").split(delimiter) if above is not None else []
        header = [name.strip() for name in names] if any(name.strip() for name in names) else None
        return Rows(source.name, header, delimiter, numbers, cells)
    return Rows(source.name, cells[0], delimiter, numbers[1:], cells[1:])


def _read_json_lines(source: SourceText) -> Table:
    objects: list[dict[str, str]] = []
    lines = source.lines()
    for line, text in lines:
        try:
            # Numbers stay text, so that stamps keep all their digits.
            value = parse_json(text, parse_float=str, parse_int=str, parse_constant=str)
        except ValueError as error:
            raise DatasetError(
                f"{source.name}, line {line}: not JSON ({error}); write one flat object per line"
            ) from error
        if not isinstance(value, dict):
            raise DatasetError(f'{source.name}, line {line}: not an object; write {{"stamp_s": 0.1, "x_m": 1.0, ...}}')
        objects.append({key: _cell(source, line, key, cell) for key, cell in value.items()})
    names = list(dict.fromkeys(name for value in objects for name in value))
    cells = [[value.get(name, "") for name in names] for value in objects]
    return Rows(source.name, names, "", [line for line, _ in lines], cells).table(names)


def _cell(source: SourceText, line: int, key: str, value: object) -> str:
    if value is None or isinstance(value, str):
        return value or ""
    raise DatasetError(
        f"{source.name}, line {line}, column {key}: {json.dumps(value)[:40]} is neither a number nor a text; "
        "write each number under a name of its own, such as x_m, y_m and z_m"
    )
