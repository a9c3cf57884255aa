"""Detections from a table of named columns: one row an object, the rows of one stamp a scan."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from logs.dslam_codec import take_rows
from logs.errors import DatasetError
from logs.importers.stamps import read_stamps
from logs.importers.tables import LENGTH_UNITS, UNLABELLED, Table
from logs.messages import DetectionTruth, FloatArray, ObjectDetections
from logs.records import frozen

BODY_FRAME = "base_link"


_SCORES = ("score", "confidence", "probability")


@frozen
class DetectionTable:
    """The detections of each scan, each followed by its truth where that is known, in the order of the stamps.

    ``left_out``: the columns that have no place in a log; ``notes``: what a user should know of the others.
    """

    records: Sequence[ObjectDetections | DetectionTruth]
    left_out: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


def read_detections(table: Table) -> DetectionTable:
    """The detections of ``table``: those of one stamp and frame are a scan.

    Needed are a stamp, x and y; z is 0 where it is missing. Others are label, score, sigmas (sigma_x_m, ...), frame
    and object_id (the truth). A row without position and label is a scan in which nothing was seen.

    Raises:
        DatasetError: a column is missing or stands there twice, a cell is wrong, the stamps are not in order, or the
            positions are in an impossible unit.
    """
    stamps_ns = read_stamps(table, strictly=False)
    labels = table.labels()
    is_empty, positions = _positions(table, labels)
    has_truth = table.find(("object_id",))
    named = tuple(label or UNLABELLED for label in labels)
    every = ObjectDetections(0, BODY_FRAME, positions, named, _scores(table), _covariances(table))
    frames = [frame or BODY_FRAME for frame in table.first_texts(("frame", "frame_id"))]
    scans: dict[tuple[int, str], list[int]] = {}
    for row, place in enumerate(zip(stamps_ns.tolist(), frames, strict=True)):
        scans.setdefault(place, []).extend([] if is_empty[row] else [row])
    records: list[ObjectDetections | DetectionTruth] = []
    for (stamp_ns, frame), rows in scans.items():
        seen = take_rows(every, N=np.array(rows, dtype=np.int64))
        records.append(replace(seen, stamp_ns=stamp_ns, frame_id=frame))
        if has_truth is not None:
            names = (table.columns[has_truth.name][row] for row in rows)
            records.append(DetectionTruth(stamp_ns, tuple("" if name == "-1" else name for name in names)))
    left_out = tuple(name for name in table.columns if name and name not in table.used)
    unlabelled = sum(not label and not empty for label, empty in zip(labels, is_empty, strict=True))
    notes = []
    if unlabelled:
        notes.append(f"{unlabelled} of {len(labels)} detections have no label and are of the class {UNLABELLED}")
    if others := {*frames} - {BODY_FRAME}:
        notes.append(
            f"detections are in {', '.join(sorted(others))}, whose place on the body is not in these files: "
            "replay with --set calibration.detection.assume_body_frame=true if it is the body"
        )
    return DetectionTable(records, left_out, tuple(notes))


def _positions(table: Table, labels: Sequence[str]) -> tuple[NDArray[np.bool_], FloatArray]:
    """Which rows (R,) have neither position nor label, and the positions (R, 3) m, zeros there."""
    columns = [table.need(axis, f"{axis}_m", (axis,), LENGTH_UNITS) for axis in "xy"]
    height = table.find(("z",), LENGTH_UNITS)
    columns += [height] if height is not None else []
    cells = zip(labels, *(table.columns[column.name] for column in columns), strict=True)
    is_empty = np.array([not any(row) for row in cells], dtype=np.bool_)
    positions = np.zeros((len(is_empty), 3))
    for i, column in enumerate(columns):
        values = table.optional_numbers(column)
        remedy = "give a number (only a row with neither position nor label is a scan without objects)"
        table.refuse(np.isnan(values) & ~is_empty, column, f"empty; {remedy}")
        positions[:, i] = np.nan_to_num(values)
        median_m = float(np.median(np.abs(positions[~is_empty, i]))) if not is_empty.all() else 0.0
        # No range at which objects are detected, but another unit or another frame.
        if median_m > 1000.0:
            raise DatasetError(
                f"{table.name}, column {column.name}: the median is {median_m:.4g} m, which is no range in the body "
                f"frame; if these are millimetres, name the column {column.name.removesuffix('_m')}_mm"
            )
    return is_empty, positions


def _scores(table: Table) -> FloatArray:
    column = table.find(_SCORES)
    if column is None:
        return np.ones(len(table.lines))
    scores = np.nan_to_num(table.optional_numbers(column), nan=1.0)
    fault = "CELL is not in [0, 1]; scale the scores to [0, 1], or rename the column"
    table.refuse((scores < 0.0) | (scores > 1.0), column, fault)
    return scores


def _sigmas(table: Table, axis: str) -> FloatArray | None:
    """Standard deviations (R,) m, NaN where a cell is empty or 0; None without such a column."""
    column = table.find((f"sigma_{axis}",), LENGTH_UNITS)
    if column is None:
        return None
    values = table.optional_numbers(column)
    table.refuse(values < 0.0, column, "CELL is not a length; leave it empty if it is not known")
    return np.where(values > 0.0, values, np.nan)


def _covariances(table: Table) -> FloatArray | None:
    """Covariances (R, 3, 3) m^2 from sigmas; zeros in rows where one is not known."""
    x, y, z = (_sigmas(table, axis) for axis in "xyz")
    if x is None and y is None and z is None:
        return None
    if x is None or y is None:
        raise DatasetError(f"{table.name}: noise needs at least the columns sigma_x_m and sigma_y_m")
    variance_z = 0.5 * (x**2 + y**2) if z is None else z**2  # a planar detector
    variances = np.stack([x**2, y**2, variance_z], axis=1)
    variances[np.isnan(variances).any(axis=1)] = 0.0
    return variances[:, :, None] * np.eye(3)
