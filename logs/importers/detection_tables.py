"""Detections from a table of named columns: one row an object, the rows of one stamp a scan."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from logs.errors import DatasetError
from logs.importers.stamps import Stamps, read_stamps
from logs.importers.tables import LENGTH_UNITS, Column, Table
from logs.messages import DetectionTruth, FloatArray, ObjectDetections

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

    def scans(self) -> Iterator[tuple[ObjectDetections, DetectionTruth | None]]:
        """The detections of each stamp and frame, and their truth, in the order of the stamps."""
        rows = pd.DataFrame({"stamp_ns": self.stamps.stamps_ns, "frame": self.frames})
        for (stamp_ns, frame), group in rows.groupby(["stamp_ns", "frame"], sort=False):
            yield self._scan(int(stamp_ns), str(frame), group.index.to_numpy()[~self.is_empty[group.index]].tolist())

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
    stamps = read_stamps(table)
    stamps.check_increasing(strictly=False)
    rows = len(table.cells)
    labels = next((found for names in LABEL_NAMES if (found := table.texts(names)) is not None), ("",) * rows)
    is_empty, positions = _positions(table, stamps, labels)
    true_ids = table.texts(_TRUE_IDS)
    return DetectionTable(
        stamps=stamps,
        positions=positions,
        labels=tuple(label or ONLY_LABEL for label in labels),
        scores=_scores(table),
        covariances=_covariances(table),
        sizes=_sizes(table),
        track_ids=table.texts(_TRACKS),
        frames=tuple(frame or BODY_FRAME for frame in table.texts(_FRAMES) or ("",) * rows),
        true_ids=None if true_ids is None else tuple("" if name == "-1" else name for name in true_ids),
        is_empty=is_empty,
        left_out=tuple(name for name in table.cells if name not in table.used),
        unlabelled_count=sum(not label and not empty for label, empty in zip(labels, is_empty, strict=True)),
    )


def _positions(table: Table, stamps: Stamps, labels: tuple[str, ...]) -> tuple[NDArray[np.bool_], FloatArray]:
    """Which rows (R,) have neither position nor label, and the positions (R, 3), zeros there."""
    found: dict[int, Column] = {}
    for i, name in enumerate("xyz"):
        names = (name, f"p{name}", f"position_{name}", f"center_{name}")
        column = table.find(names, LENGTH_UNITS)
        if column is not None:
            found[i] = column
        elif name != "z":
            table.need(name, f"{name}_m", names, LENGTH_UNITS)
    cells = table.cells[[column.name for column in found.values()]].assign(labels=labels)
    is_empty = np.asarray((cells == "").all(axis=1))
    # A row without a position means that its scan is empty; beside others of the scan it is a mistake.
    is_alone = ~pd.Series(stamps.stamps_ns).duplicated(keep=False).to_numpy()
    table.refuse(is_empty & ~is_alone, found[0], "empty, in a scan that has other rows; give a position")
    positions = np.zeros((len(is_empty), 3))
    for i, column in found.items():
        values = table.optional_numbers(column, LENGTH_UNITS)
        remedy = "give a number (only a row with neither position nor label is a scan without objects)"
        table.refuse(np.isnan(values) & ~is_empty, column, f"empty; {remedy}")
        positions[:, i] = np.nan_to_num(values)
        median_m = float(np.median(np.abs(positions[~is_empty, i]))) if not is_empty.all() else 0.0
        table.refuse(
            (np.abs(positions[:, i]) >= median_m) & (median_m > MAX_RANGE_M),
            column,
            f"CELL: the median of {column.name} is {median_m:.4g} m, which is no range in the body frame; if these are "
            f"millimetres, call the column {column.name.removesuffix('_m')}_mm",
        )
    return is_empty, positions


def _scores(table: Table) -> FloatArray:
    column = table.find(_SCORES)
    if column is None:
        return np.ones(len(table.cells))
    scores = np.nan_to_num(table.optional_numbers(column), nan=1.0)
    fault = "CELL is not in [0, 1]; scale the scores to that, or rename the column"
    table.refuse((scores < 0.0) | (scores > 1.0), column, fault)
    return scores


def _lengths(table: Table, fields: tuple[str, ...]) -> FloatArray | None:
    """Lengths (R,) m, NaN where a cell is empty or 0; None without such a column."""
    column = table.find(fields, LENGTH_UNITS)
    if column is None:
        return None
    values = table.optional_numbers(column, LENGTH_UNITS)
    table.refuse(values < 0.0, column, "CELL is not a length; leave it empty if it is not known")
    return np.where(values > 0.0, values, np.nan)


def _covariances(table: Table) -> FloatArray | None:
    """Covariances (R, 3, 3) m^2 from their entries, else from sigmas; zeros in rows where one is not known."""
    P = np.zeros((len(table.cells), 3, 3))
    entries = [
        ((i, j), table.find([f"{stem}{'xyz'[i]}{'xyz'[j]}" for stem in ("c", "cov_", "covariance_")], _AREA_UNITS))
        for i, j in _ENTRIES
    ]
    sigmas = [_lengths(table, (f"sigma_{axis}", f"std_{axis}")) for axis in "xyz"]
    there = {place: column for place, column in entries if column is not None}
    given = {place: table.optional_numbers(column, _AREA_UNITS) for place, column in there.items()}
    given = given or {(i, i): values**2 for i, values in enumerate(sigmas) if values is not None}
    if not given:
        return None
    if not {(0, 0), (1, 1)} <= given.keys():
        raise DatasetError(f"{table.name}: a covariance needs at least cxx, cxy and cyy, or sigma_x_m and sigma_y_m")
    for (i, j), values in given.items():
        P[:, i, j] = P[:, j, i] = values
    if (2, 2) not in given:  # a planar detector
        P[:, 2, 2] = 0.5 * (P[:, 0, 0] + P[:, 1, 1])
    P[~np.isfinite(P).all(axis=(1, 2))] = 0.0
    wrong = P.any(axis=(1, 2)) & (np.linalg.eigvalsh(P)[:, 0] <= 0.0)
    if wrong.any():
        columns = " ".join(column.name for column in there.values())
        raise table.error(int(wrong.argmax()), columns, "not positive definite; leave the cells empty if not known")
    return P


def _sizes(table: Table) -> FloatArray | None:
    diameter = _lengths(table, _DIAMETERS)
    sides = [_lengths(table, names) for names in _SIDES]
    if diameter is None and all(side is None for side in sides):
        return None
    sizes = np.full((len(table.cells), 3), np.nan)
    if diameter is not None:
        sizes[:, :2] = diameter[:, None]  # that of a pole or a stem is not its height
    for i, side in enumerate(sides):
        if side is not None:
            sizes[:, i] = side
    return sizes
