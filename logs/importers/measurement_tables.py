"""Measurements from tables of named columns: detections, a row for each object, the rows of one stamp a scan; and fixes
of a satellite receiver.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from logs.dslam_codec import take_rows
from logs.errors import DatasetError
from logs.importers.tables import DEGREES, LABEL_NAMES, LENGTH_UNITS, UNLABELLED, Column, Table
from logs.messages import DetectionTruth, FloatArray, GeodeticFix, ObjectDetections
from logs.records import frozen

BODY_FRAME = "base_link"


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
    stamps_ns = table.stamps(strictly=False)
    labels = table.first_texts(LABEL_NAMES)
    is_empty, positions = _positions(table, labels)
    truth = table.find(("object_id",))
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
        if truth is not None:
            names = (truth.cells[row] for row in rows)
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
    columns += filter(None, [table.find(("z",), LENGTH_UNITS)])
    cells = zip(labels, *(column.cells for column in columns), strict=True)
    is_empty = np.array([not any(row) for row in cells], dtype=np.bool_)
    positions = np.zeros((len(is_empty), 3))
    for i, column in enumerate(columns):
        values = column.numbers(empty=np.nan)
        remedy = "give a number (only a row with neither position nor label is a scan without objects)"
        column.refuse(np.isnan(values) & ~is_empty, f"empty; {remedy}")
        positions[:, i] = np.nan_to_num(values)
        median_m = np.median(np.abs(values[~is_empty])) if not is_empty.all() else 0.0
        # No range at which objects are detected, but another unit or another frame.
        if median_m > 1000.0:
            raise DatasetError(
                f"{table.name}, column {column.name}: the median is {median_m:.4g} m, which is no range in the body "
                f"frame; if these are millimetres, name the column {column.name.removesuffix('_m')}_mm"
            )
    return is_empty, positions


def _scores(table: Table) -> FloatArray:
    column = table.find(("score", "confidence", "probability"))
    if column is None:
        return np.ones(len(table.lines))
    scores = column.numbers(empty=1.0)
    fault = "CELL is not in [0, 1]; scale the scores to [0, 1], or rename the column"
    column.refuse((scores < 0.0) | (scores > 1.0), fault)
    return scores


def _covariances(table: Table) -> FloatArray | None:
    """Covariances (R, 3, 3) m^2 from sigmas; zeros in rows where one is not known; None without such columns."""
    columns = [table.find((f"sigma_{axis}",), LENGTH_UNITS) for axis in "xyz"]
    if not any(columns):
        return None
    x, y, z = (None if column is None else _variances(column) for column in columns)
    if x is None or y is None:
        raise DatasetError(f"{table.name}: noise needs at least the columns sigma_x_m and sigma_y_m")
    variances = np.stack([x, y, 0.5 * (x + y) if z is None else z], axis=1)  # without z of a planar detector
    variances[(variances == 0.0).any(axis=1)] = 0.0
    return variances[:, :, None] * np.eye(3)


def _variances(sigma: Column) -> FloatArray:
    """Squares (R,) m^2 of standard deviations, 0 where a cell is empty."""
    values = sigma.numbers(empty=0.0)
    sigma.refuse(values < 0.0, "CELL is not a length; leave it empty if it is not known")
    return values**2


def read_fixes(table: Table) -> list[GeodeticFix]:
    """The fixes of ``table``, one a row; the altitude is 0 where it is missing, ``sigma_m`` is of each coordinate.

    Raises:
        DatasetError: a column is missing or stands there twice, a cell is wrong, or the stamps are not in order.
    """
    columns = (
        table.stamps(strictly=False),
        _angles(table, "latitude", "lat", 90.0),
        _angles(table, "longitude", "lon", 180.0),
        table.lengths(("altitude", "alt", "height")),
        table.lengths(("sigma",)),
    )
    return [
        GeodeticFix(stamp_ns, "gnss", latitude, longitude, height_m, sigma_m**2 * np.eye(3) if sigma_m > 0.0 else None)
        for stamp_ns, latitude, longitude, height_m, sigma_m in zip(*map(np.ndarray.tolist, columns), strict=True)
    ]


def _angles(table: Table, name: str, short: str, largest_deg: float) -> FloatArray:
    column = table.need(f"the {name}", f"{name}_deg", (name, short), DEGREES)
    values = column.numbers()
    column.refuse(np.abs(values) > largest_deg, f"CELL is no {name} in degrees; write it in decimal degrees")
    return values
