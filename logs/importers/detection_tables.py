"""Detections from a table of named columns: one row an object, the rows of one stamp a scan."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from logs.errors import DatasetError
from logs.importers.stamps import Stamps, read_stamps
from logs.importers.tables import LENGTH_UNITS, Column, Table
from logs.messages import DetectionTruth, FloatArray, IntArray, ObjectDetections

ONLY_LABEL = "object"
"""Class of detections that have none."""

BODY_FRAME = "base_link"

MAX_RANGE_M = 1000.0
"""A median beyond it is no range at which objects are detected, but another unit or another frame."""

LABEL_NAMES = (("label", "class", "class_name", "category"), ("name",), ("type",), ("class_id", "category_id"))
"""Names of the column with the class, of which the first group that the table has is taken."""
_SCORES = ("score", "confidence", "probability")
_TRACKS = ("track_id", "track")
_FRAMES = ("frame", "frame_id")
_TRUE_IDS = ("object_id", "true_id")
_DIAMETERS = ("diameter", "size")
_SIDES = (("sx", "size_x", "length"), ("sy", "size_y", "width"), ("sz", "size_z", "height"))
_ENTRIES = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
_AREA_UNITS = {"": 1.0, "m2": 1.0}


@dataclass(frozen=True, slots=True, eq=False)
class DetectionTable:
    """Detections (R,) in the order of their stamps.

    positions (R, 3) m in the frame of each row; scores (R,) in [0, 1]; covariances (R, 3, 3) m^2, zeros where not
    known; sizes (R, 3) m, NaN where not known; ``true_ids``: the object that each shows, "" for a false positive, None
    where the file has none; ``is_empty`` (R,): rows without position and label, for scans in which nothing was seen;
    ``left_out``: the columns that have no place in a log; ``unlabelled_count``: how many became ``ONLY_LABEL``.
    """

    stamps: Stamps
    positions: FloatArray
    labels: tuple[str, ...]
    scores: FloatArray
    covariances: FloatArray | None
    sizes: FloatArray | None
    track_ids: tuple[str, ...] | None
    frames: tuple[str, ...]
    true_ids: tuple[str, ...] | None
    is_empty: NDArray[np.bool_]
    left_out: tuple[str, ...]
    unlabelled_count: int

    def scans(self, stamps_ns: IntArray) -> Iterator[tuple[ObjectDetections, DetectionTruth | None]]:
        """The detections of each stamp and frame, and their truth, in the order of ``stamps_ns`` (R,)."""
        for stamp_ns, group in groupby(enumerate(stamps_ns.tolist()), key=lambda pair: pair[1]):
            rows = [row for row, _ in group]
            for frame in dict.fromkeys(self.frames[row] for row in rows):
                yield self._scan(stamp_ns, frame, [r for r in rows if self.frames[r] == frame and not self.is_empty[r]])

    def _scan(self, stamp_ns: int, frame: str, rows: list[int]) -> tuple[ObjectDetections, DetectionTruth | None]:
        detections = ObjectDetections(
            stamp_ns,
            frame,
            self.positions[rows],
            tuple(self.labels[row] for row in rows),
            self.scores[rows],
            None if self.covariances is None else self.covariances[rows],
            None if self.sizes is None else self.sizes[rows],
            None if self.track_ids is None else tuple(self.track_ids[row] for row in rows),
        )
        truth = None if self.true_ids is None else DetectionTruth(stamp_ns, tuple(self.true_ids[row] for row in rows))
        return detections, truth


def read_detections(table: Table) -> DetectionTable:
    """The detections of ``table``.

    Needed are a stamp, x and y; z is 0 where it is missing. Others are label, score, the covariance (cxx, cxy, ...) or
    sigmas (sigma_x_m, ...), sizes (sx, sy, sz) or a diameter, track_id, frame and object_id (the truth).

    Raises:
        DatasetError: a column is missing or stands there twice, a cell is wrong, the stamps are not in order, or the
            positions are in an impossible unit.
    """
    columns = _Columns(table)
    stamps = read_stamps(table)
    columns.used.add(stamps.column.name)
    stamps.check_increasing(strictly=False)
    labels = columns.labels()
    is_empty, positions = _positions(columns, stamps, labels)
    true_ids = columns.texts(_TRUE_IDS)
    return DetectionTable(
        stamps=stamps,
        positions=positions,
        labels=tuple(label or ONLY_LABEL for label in labels),
        scores=_scores(columns),
        covariances=_covariances(columns),
        sizes=_sizes(columns),
        track_ids=columns.texts(_TRACKS),
        frames=tuple(frame or BODY_FRAME for frame in columns.texts(_FRAMES) or ("",) * len(labels)),
        true_ids=None if true_ids is None else tuple("" if name == "-1" else name for name in true_ids),
        is_empty=is_empty,
        left_out=tuple(name for name in table.columns if name not in columns.used),
        unlabelled_count=sum(not label and not empty for label, empty in zip(labels, is_empty, strict=True)),
    )


class _Columns:
    """The columns of a table, of which those that were found are ``used``."""

    def __init__(self, table: Table) -> None:
        self.table = table
        self.used: set[str] = set()

    def find(self, fields: tuple[str, ...], units: tuple[str, ...] = ("",)) -> Column | None:
        column = self.table.find(fields, units)
        if column is not None:
            self.used.add(column.name)
        return column

    def texts(self, fields: tuple[str, ...]) -> tuple[str, ...] | None:
        column = self.find(fields)
        return None if column is None else tuple(self.table.columns[column.name])

    def labels(self) -> tuple[str, ...]:
        """The classes (R,), "" where there is none."""
        found = (self.texts(names) for names in LABEL_NAMES)
        return next((labels for labels in found if labels is not None), ("",) * len(self.table.lines))

    def lengths(self, fields: tuple[str, ...]) -> FloatArray | None:
        """Lengths (R,) m, NaN where a cell is empty or 0; None without such a column."""
        column = self.find(fields, tuple(LENGTH_UNITS))
        if column is None:
            return None
        values = self.table.optional_numbers(column, LENGTH_UNITS)
        self.table.refuse(values < 0.0, column, "CELL is not a length; leave it empty if it is not known")
        return np.where(values > 0.0, values, np.nan)


def _positions(columns: _Columns, stamps: Stamps, labels: tuple[str, ...]) -> tuple[NDArray[np.bool_], FloatArray]:
    """Which rows (R,) have neither position nor label, and the positions (R, 3), zeros there."""
    table = columns.table
    found: dict[int, Column] = {}
    for i, name in enumerate("xyz"):
        names = (name, f"p{name}", f"position_{name}", f"center_{name}")
        column = columns.find(names, tuple(LENGTH_UNITS))
        if column is not None:
            found[i] = column
        elif name != "z":
            table.need(name, f"{name}_m", names, LENGTH_UNITS)
    cells = [labels, *(table.columns[column.name] for column in found.values())]
    is_empty = np.array([not any(row) for row in zip(*cells, strict=True)])
    # A row without a position means that its scan is empty; beside others of the scan it is a mistake.
    _, scans, counts = np.unique(stamps.stamps_ns, return_inverse=True, return_counts=True)
    table.refuse(is_empty & (counts[scans] > 1), found[0], "empty, in a scan that has other rows; give a position")
    positions = np.zeros((len(is_empty), 3))
    for i, column in found.items():
        values = table.optional_numbers(column, LENGTH_UNITS, remedy="correct or remove the line")
        remedy = "give a number (only a row with neither position nor label is a scan without objects)"
        table.refuse(np.isnan(values) & ~is_empty, column, f"empty; {remedy}")
        positions[:, i] = np.where(is_empty, 0.0, values)
        _check_range(table, column, np.abs(values))
    return is_empty, positions


def _check_range(table: Table, column: Column, lengths_m: FloatArray) -> None:
    known = lengths_m[np.isfinite(lengths_m)]
    median_m = float(np.median(known)) if len(known) else 0.0
    table.refuse(
        (lengths_m >= median_m) & (median_m > MAX_RANGE_M),
        column,
        f"CELL: the median of {column.name} is {median_m:.4g} m; positions are metres in the body frame: if these are "
        f"millimetres, call the column {column.name.removesuffix('_m')}_mm",
    )


def _scores(columns: _Columns) -> FloatArray:
    column = columns.find(_SCORES)
    if column is None:
        return np.ones(len(columns.table.lines))
    scores = np.nan_to_num(columns.table.optional_numbers(column), nan=1.0)
    fault = "CELL is not in [0, 1]; scale the scores to that, or rename the column"
    columns.table.refuse((scores < 0.0) | (scores > 1.0), column, fault)
    return scores


def _covariances(columns: _Columns) -> FloatArray | None:
    table = columns.table
    entries = {
        (i, j): columns.find(tuple(f"{stem}{'xyz'[i]}{'xyz'[j]}" for stem in ("c", "cov_", "covariance_")), ("", "m2"))
        for i, j in _ENTRIES
    }
    sigmas = {name: columns.lengths((name, name.replace("sigma", "std"))) for name in ("sigma_x", "sigma_y", "sigma_z")}
    given = [name for name, values in sigmas.items() if values is not None]
    there = {place: column for place, column in entries.items() if column is not None}
    if there and given:
        raise DatasetError(f"{table.name}: both sigmas and covariances; remove the columns of one of them")
    P = np.zeros((len(table.lines), 3, 3))
    for i, values in enumerate(sigmas.values()):
        if values is not None:
            P[:, i, i] = values**2
    for (i, j), column in there.items():
        P[:, i, j] = P[:, j, i] = table.optional_numbers(column, _AREA_UNITS)
    if given and not {"sigma_x", "sigma_y"} <= {*given}:
        raise DatasetError(f"{table.name}: only {given[0]}; give a sigma for x and one for y (and for z)")
    missing = next((f"c{'xyz'[i]}{'xyz'[i]}" for i in (0, 1) if there and (i, i) not in there), None)
    if missing is not None:
        raise DatasetError(f"{table.name}: covariances without the column {missing}; give at least cxx, cxy and cyy")
    if not there and not given:
        return None
    if (2, 2) not in there and "sigma_z" not in given:  # a planar detector
        P[:, 2, 2] = 0.5 * (P[:, 0, 0] + P[:, 1, 1])
    P[~np.isfinite(P).all(axis=(1, 2))] = 0.0
    wrong = P.any(axis=(1, 2)) & (np.linalg.eigvalsh(P)[:, 0] <= 0.0)
    names = Column(" ".join(column.name for column in there.values()), "")
    if wrong.any():
        fault = "not positive definite; leave the cells empty if it is not known"
        raise table.error(int(wrong.argmax()), names, fault)
    return P


def _sizes(columns: _Columns) -> FloatArray | None:
    diameter = columns.lengths(_DIAMETERS)
    sides = [columns.lengths(names) for names in _SIDES]
    if diameter is None and all(side is None for side in sides):
        return None
    sizes = np.full((len(columns.table.lines), 3), np.nan)
    if diameter is not None:
        sizes[:, :2] = diameter[:, None]  # that of a pole or a stem is not its height
    for i, side in enumerate(sides):
        if side is not None:
            sizes[:, i] = side
    return sizes
