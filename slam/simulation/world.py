"""The world that is driven through: objects that stand still, and a tour past them."""

from __future__ import annotations

import csv
import hashlib
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from io import BytesIO, TextIOWrapper
from pathlib import Path

import numpy as np

from logs.storage.regular_file import read_regular
from logs.validation import LARGEST_M
from slam.common.arrays import FloatArray
from slam.common.errors import SimulationError

OBJECT_COLUMNS = ("x_m", "y_m", "z_m", "class", "id")
TOUR_COLUMNS = ("x_m", "y_m")


@dataclass(frozen=True, slots=True, eq=False)
class World:
    """Objects and tour in the world frame, metres, z up.

    object_ids (N,) unique; positions (N, 3); labels (N,); tour (M, 2) poly-line with at least two different points.

    Raises:
        SimulationError: no object, numbers that disagree or are not finite, an id used twice, or a tour of no length.
    """

    name: str
    object_ids: tuple[str, ...]
    positions: FloatArray
    labels: tuple[str, ...]
    tour: FloatArray

    def __post_init__(self) -> None:
        count = len(self.object_ids)
        if count == 0:
            raise SimulationError(f"world {self.name!r} has no object; give it at least one")
        if self.positions.shape != (count, 3) or len(self.labels) != count:
            raise SimulationError(
                f"world {self.name!r}: {count} ids, {len(self.labels)} labels, positions {self.positions.shape}; "
                f"expected ({count}, 3)"
            )
        if len(set(self.object_ids)) != count:
            raise SimulationError(f"world {self.name!r}: object ids are not unique")
        if self.tour.ndim != 2 or self.tour.shape[1] != 2 or len(self.tour) < 2:
            raise SimulationError(f"world {self.name!r}: tour {self.tour.shape}; expected (M, 2) with M >= 2")
        if not (np.isfinite(self.positions).all() and np.isfinite(self.tour).all()):
            raise SimulationError(f"world {self.name!r}: positions or tour are not finite")
        if self.tour_length_m == 0.0:
            raise SimulationError(f"world {self.name!r}: all {len(self.tour)} points of the tour are the same")

    @property
    def vocabulary(self) -> tuple[str, ...]:
        """The classes that occur, sorted."""
        return tuple(sorted(set(self.labels)))

    @property
    def tour_length_m(self) -> float:
        """Length of the poly-line, metres."""
        return float(np.linalg.norm(np.diff(self.tour, axis=0), axis=1).sum())

    def shortened(self, length_m: float) -> World:
        """The same world with the first ``length_m`` metres of the tour; the whole tour if it is no longer than that.

        Raises:
            SimulationError: ``length_m`` is not a positive length.
        """
        if not length_m > 0.0:
            raise SimulationError(f"length {length_m:g} m: a tour needs a length above 0 m")
        along_m = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(self.tour, axis=0), axis=1)))
        if length_m >= along_m[-1]:
            return self
        end = [np.interp(length_m, along_m, self.tour[:, axis]) for axis in (0, 1)]
        return replace(self, tour=np.vstack([self.tour[along_m < length_m], end]))

    def sha256(self) -> str:
        """Digest over ids, labels, positions and tour: the same world has the same, wherever it comes from."""
        digest = hashlib.sha256()
        for name, label in zip(self.object_ids, self.labels, strict=True):
            digest.update(f"{name}\0{label}\n".encode())
        digest.update(np.ascontiguousarray(self.positions, dtype="<f8").tobytes())
        digest.update(np.ascontiguousarray(self.tour, dtype="<f8").tobytes())
        return digest.hexdigest()


def load_world(objects: Path, trajectory: Path, *, name: str | None = None) -> World:
    """Read a world from two CSV files with a header line.

    Args:
        objects: columns ``x_m, y_m, z_m, class, id``; further columns are passed over.
        trajectory: columns ``x_m, y_m``, the points of the tour in order.
        name: what outputs call the world; by default the name of the folder that holds ``objects``.

    Raises:
        SimulationError: a missing or unreadable file, a missing column, no finite number, an empty class or id, an id
            used twice, fewer than two poses; names the file and the line.
    """
    ids, positions, labels = _read_objects(objects)
    tour = [
        [_number(trajectory, line, column, row[column]) for column in TOUR_COLUMNS]
        for line, row in _rows(trajectory, TOUR_COLUMNS)
    ]
    if len(tour) < 2:
        raise SimulationError(f"{trajectory}: {len(tour)} poses; a tour needs at least two")
    name = objects.resolve().parent.name if name is None else name
    return World(name, ids, positions, labels, np.array(tour))


def load_objects(objects: Path) -> tuple[FloatArray, tuple[str, ...]]:
    """Positions (N, 3) m and labels (N,) of a CSV file of objects.

    Raises:
        SimulationError: as :func:`load_world`.
    """
    return _read_objects(objects)[1:]


def _read_objects(objects: Path) -> tuple[tuple[str, ...], FloatArray, tuple[str, ...]]:
    first_line: dict[str, int] = {}
    positions: list[list[float]] = []
    labels: list[str] = []
    for line, row in _rows(objects, OBJECT_COLUMNS):
        positions.append([_number(objects, line, column, row[column]) for column in OBJECT_COLUMNS[:3]])
        label, object_id = row["class"].strip(), row["id"].strip()
        if not label or not object_id:
            raise SimulationError(f"{objects}, line {line}: empty {'id' if label else 'class'}; every object needs one")
        if object_id in first_line:
            raise SimulationError(
                f"{objects}, line {line}: id {object_id!r} is taken by line {first_line[object_id]}; ids are unique"
            )
        first_line[object_id] = line
        labels.append(label)
    if not labels:
        raise SimulationError(f"{objects}: no object in it; give it at least one line below the header")
    return tuple(first_line), np.array(positions), tuple(labels)


def _rows(path: Path, columns: tuple[str, ...]) -> Iterator[tuple[int, dict[str, str]]]:
    try:
        with TextIOWrapper(BytesIO(read_regular(path)), encoding="utf-8-sig", newline="") as stream:
            reader = csv.DictReader(stream)
            missing = [column for column in columns if column not in (reader.fieldnames or ())]
            if missing:
                raise SimulationError(
                    f"{path}, line 1: no column {', '.join(missing)}; expected {','.join(columns)} in the header"
                )
            for row in reader:
                if any(row[column] is None for column in columns):
                    raise SimulationError(f"{path}, line {reader.line_num}: fewer values than the header has columns")
                yield reader.line_num, row
    except OSError as error:
        raise SimulationError(f"{path}: cannot be read ({error.strerror}); give the path of a CSV file") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise SimulationError(f"{path}: not a CSV file in UTF-8 ({error})") from error


def _number(path: Path, line: int, column: str, text: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not abs(number) <= LARGEST_M:
        raise SimulationError(f"{path}, line {line}: {column} is {text[:40]!r}, not a number up to {LARGEST_M:g}")
    return number
