"""Detections from a table of named columns: one row an object, the rows of one stamp a scan."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from logs.errors import DatasetError
from logs.importers.stamps import Stamps, read_stamps
from logs.importers.tables import LENGTH_UNITS, Column, Table
from logs.messages import DetectionTruth, FloatArray, IntArray, ObjectDetections

ONLY_LABEL = "object"
"""Class of detections that have none."""

BODY_FRAME = "base_link"

FARTHEST_M = 1000.0
"""A median beyond it is no range at which objects are detected, but another unit or another frame."""

_LABELS = ("label", "class", "class_name", "category")
_SCORES = ("score", "confidence", "probability")
_TRACKS = ("track_id", "track")
_FRAMES = ("frame", "frame_id")
_TRUE_IDS = ("object_id", "true_id")
_FALSE_POSITIVES = ("", "-1")
_DIAMETERS = ("diameter", "size")
_SIZES = (("sx", "size_x", "length"), ("sy", "size_y", "width"), ("sz", "size_z", "height"))
_ENTRIES = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
_COVARIANCES = ("c", "cov_", "covariance_")
_SIGMAS = ("sigma_", "std_")
_AREA_UNITS = {"": 1.0, "m2": 1.0}


@dataclass(frozen=True, slots=True, eq=False)
class DetectionTable:
    """Detections (R,) in the order of their stamps.

    positions (R, 3) m in the frame of each row; scores (R,) in [0, 1]; covariances (R, 3, 3) m^2, zeros where not
    known; sizes (R, 3) m, NaN where not known; ``true_ids``: the object that each shows, "" for a false positive, None
    where the file tells none; ``is_empty`` (R,): rows without position and label, for scans in which nothing was seen;
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
        starts = np.flatnonzero(np.diff(stamps_ns, prepend=stamps_ns[0] - 1))
        for rows in np.split(np.arange(len(stamps_ns)), starts[1:]):
            stamp_ns = int(stamps_ns[rows[0]])
            for frame in dict.fromkeys(self.frames[row] for row in rows):
                chosen = [int(row) for row in rows if self.frames[row] == frame and not self.is_empty[row]]
                yield self._scan(stamp_ns, frame, chosen)

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
        if self.true_ids is None:
            return detections, None
        return detections, DetectionTruth(stamp_ns, tuple(self.true_ids[row] for row in rows))


def read_detections(table: Table) -> DetectionTable:
    """The detections of ``table``.

    Needed are a stamp, x and y; z is 0 where it is missing. Others are label, score, the covariance (cxx, cxy, ...) or
    sigmas (sigma_x_m, ...), sizes (sx, sy, sz) or a diameter, track_id, frame and object_id (the truth).

    Raises:
        DatasetError: a column is missing or stands there twice, a cell is wrong, the stamps are not in order, or the
            positions are in an impossible unit.
    """
    return _Reading(table).run()


class _Reading:
    """Takes columns from a table and remembers which."""

    def __init__(self, table: Table) -> None:
        self._table = table
        self._used: set[str] = set()

    def run(self) -> DetectionTable:
        stamps = read_stamps(self._table)
        self._used.add(stamps.column.name)
        stamps.check_increasing(strictly=False)
        is_empty, positions = self._positions(stamps)
        labels = self._texts(_LABELS) or ("",) * len(positions)
        return DetectionTable(
            stamps=stamps,
            positions=positions,
            labels=tuple(label or ONLY_LABEL for label in labels),
            scores=self._scores(),
            covariances=self._covariances(),
            sizes=self._sizes(),
            track_ids=self._texts(_TRACKS),
            frames=tuple(frame or BODY_FRAME for frame in self._texts(_FRAMES) or [""] * len(positions)),
            true_ids=self._true_ids(),
            is_empty=is_empty,
            left_out=tuple(name for name in self._table.columns if name not in self._used),
            unlabelled_count=sum(not label and not empty for label, empty in zip(labels, is_empty, strict=True)),
        )

    def _find(self, fields: tuple[str, ...], units: tuple[str, ...] = ("",)) -> Column | None:
        column = self._table.find(fields, units)
        if column is not None:
            self._used.add(column.name)
        return column

    def _texts(self, fields: tuple[str, ...]) -> tuple[str, ...] | None:
        column = self._find(fields)
        return None if column is None else tuple(self._table.columns[column.name])

    def _true_ids(self) -> tuple[str, ...] | None:
        ids = self._texts(_TRUE_IDS)
        return None if ids is None else tuple("" if name in _FALSE_POSITIVES else name for name in ids)

    def _positions(self, stamps: Stamps) -> tuple[NDArray[np.bool_], FloatArray]:
        """Which rows (R,) have neither position nor label, and the positions (R, 3), zeros there."""
        table = self._table
        columns: list[Column | None] = []
        for name in "xyz":
            fields = (name, f"p{name}", f"position_{name}", f"center_{name}")
            if name != "z":
                table.need(name, f"{name}_m", fields, LENGTH_UNITS)
            columns.append(self._find(fields, tuple(LENGTH_UNITS)))
        there = [column for column in (*columns, self._find(_LABELS)) if column is not None]
        is_empty = np.array([not any(cells) for cells in zip(*(table.columns[c.name] for c in there), strict=True)])
        self._check_alone(stamps, is_empty, there[0])
        positions = np.zeros((len(is_empty), 3))
        for i, column in enumerate(columns):
            if column is None:
                continue
            values = table.optional_numbers(column, LENGTH_UNITS, remedy="correct or remove the line")
            missing = np.flatnonzero(np.isnan(values) & ~is_empty)
            if len(missing):
                remedy = "give a number (only a row with neither position nor label is a scan without objects)"
                raise table.error(int(missing[0]), column, f"empty; {remedy}")
            positions[:, i] = np.where(is_empty, 0.0, values)
            self._check_range(column, values)
        return is_empty, positions

    def _check_alone(self, stamps: Stamps, is_empty: NDArray[np.bool_], column: Column) -> None:
        """A row without a position says that its scan is empty; beside others of the scan it is a mistake."""
        _, scans, counts = np.unique(stamps.stamps_ns, return_inverse=True, return_counts=True)
        wrong = np.flatnonzero(is_empty & (counts[scans] > 1))
        if len(wrong):
            raise self._table.error(int(wrong[0]), column, "empty, in a scan that has other rows; give a position")

    def _check_range(self, column: Column, values: FloatArray) -> None:
        known = np.abs(values[np.isfinite(values)])
        median_m = float(np.median(known)) if len(known) else 0.0
        if median_m > FARTHEST_M:
            row = int(np.nanargmax(np.abs(values) >= median_m))
            raise self._table.error(
                row,
                column,
                f"{self._table.columns[column.name][row]}: the median of {column.name} is {median_m:.4g} m; "
                f"positions are metres in the body frame: if these are millimetres, call the column "
                f"{column.name.removesuffix('_m')}_mm",
            )

    def _scores(self) -> FloatArray:
        column = self._find(_SCORES)
        if column is None:
            return np.ones(len(self._table.lines))
        scores = self._table.optional_numbers(column)
        scores = np.where(np.isnan(scores), 1.0, scores)
        wrong = np.flatnonzero((scores < 0.0) | (scores > 1.0))
        if len(wrong):
            row = int(wrong[0])
            cell = self._table.columns[column.name][row]
            raise self._table.error(
                row, column, f"{cell} is not in [0, 1]; scale the scores to that, or rename the column"
            )
        return scores

    def _covariances(self) -> FloatArray | None:
        entries = {
            (i, j): self._find(tuple(f"{stem}{'xyz'[i]}{'xyz'[j]}" for stem in _COVARIANCES), tuple(_AREA_UNITS))
            for i, j in _ENTRIES
        }
        sigmas = [self._find(tuple(f"{stem}{axis}" for stem in _SIGMAS), tuple(LENGTH_UNITS)) for axis in "xyz"]
        if any(entries.values()) and any(sigmas):
            raise DatasetError(f"{self._table.name}: both sigmas and covariances; remove the columns of one of them")
        if any(sigmas):
            return self._squares([column for column in sigmas if column is not None], sigmas)
        return self._full_covariances(entries) if any(entries.values()) else None

    def _squares(self, there: list[Column], sigmas: list[Column | None]) -> FloatArray:
        """Diagonal covariances of sigmas; where z has none, its variance is the mean of the others'."""
        if sigmas[0] is None or sigmas[1] is None:
            raise DatasetError(
                f"{self._table.name}: only {there[0].name}; give a sigma for x and one for y (and for z)"
            )
        variances = np.stack([self._lengths(column) ** 2 for column in there], axis=1)
        if len(there) == 2:
            variances = np.column_stack([variances, variances.mean(axis=1)])
        variances[~np.isfinite(variances).all(axis=1)] = 0.0
        return variances[:, None, :] * np.eye(3)

    def _full_covariances(self, entries: dict[tuple[int, int], Column | None]) -> FloatArray:
        """Covariances of their upper triangles; zeros where a cell is empty or all are 0."""
        table = self._table
        for i, j in ((0, 0), (1, 1)):
            if entries[i, j] is None:
                name = f"c{'xyz'[i]}{'xyz'[j]}"
                raise DatasetError(
                    f"{table.name}: covariances without the column {name}; give at least cxx, cxy and cyy"
                )
        P = np.zeros((len(table.lines), 3, 3))
        for (i, j), column in entries.items():
            if column is not None:
                P[:, i, j] = P[:, j, i] = table.optional_numbers(column, _AREA_UNITS)
        if entries[2, 2] is None:
            # A planar detector: as for sigmas.
            P[:, 2, 2] = 0.5 * (P[:, 0, 0] + P[:, 1, 1])
        P[~np.isfinite(P).all(axis=(1, 2))] = 0.0
        wrong = np.flatnonzero(P.any(axis=(1, 2)) & (np.linalg.eigvalsh(P)[:, 0] <= 0.0))
        if len(wrong):
            names = " ".join(column.name for column in entries.values() if column is not None)
            raise table.error(
                int(wrong[0]),
                names,
                "not positive definite, so no covariance; leave the cells empty if it is not known",
            )
        return P

    def _sizes(self) -> FloatArray | None:
        table = self._table
        diameter = self._find(_DIAMETERS, tuple(LENGTH_UNITS))
        sides = [self._find(fields, tuple(LENGTH_UNITS)) for fields in _SIZES]
        if diameter is None and not any(sides):
            return None
        sizes = np.full((len(table.lines), 3), np.nan)
        if diameter is not None:
            # The diameter of a pole or a stem says nothing of its height.
            sizes[:, :2] = self._lengths(diameter)[:, None]
        for i, column in enumerate(sides):
            if column is not None:
                sizes[:, i] = self._lengths(column)
        return sizes

    def _lengths(self, column: Column) -> FloatArray:
        """Lengths (R,) m, NaN where a cell is empty or 0."""
        values = self._table.optional_numbers(column, LENGTH_UNITS)
        negative = np.flatnonzero(values < 0.0)
        if len(negative):
            row = int(negative[0])
            raise self._table.error(
                row, column, f"{self._table.columns[column.name][row]} is no length; leave it empty if it is not known"
            )
        return np.where(values > 0.0, values, np.nan)
