"""What a program may get wrong in the records that it makes: shapes, types and transforms.

Numbers that are not finite pass: a log holds what a sensor said, and its reader leaves such messages out.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from logs import messages as m
from logs.errors import InvalidRecordError
from logs.validation import rotation_errors

ROTATION_TOLERANCE = 1e-3
"""Of the entries of R^T R: float32 and four digits stay below it."""

_TRANSFORMS = ("T_odom_body", "T_parent_child", "T_world_body", "T_map_body", "T_map_odom")
_ROWS = {"positions": (3,), "scores": (), "covariances": (3, 3), "sizes": (3,)}
"""Arrays that have a row for each label, and the shape of a row."""


def check_record(record: m.Record) -> None:
    """See that a pose or detections have the arrays that :mod:`logs.messages` documents.

    Raises:
        InvalidRecordError: another shape or type, or a matrix that is no rigid transform; names the field and the
            remedy.
    """
    if not isinstance(record, m.Odometry | m.Transform | m.GroundTruthPose | m.SlamPose | m.ObjectDetections):
        return
    if not isinstance(record.stamp_ns, int | np.integer):
        raise _error(record, "stamp_ns", f"{record.stamp_ns!r:.40}; give a whole number of nanoseconds")
    if isinstance(record, m.ObjectDetections):
        if not isinstance(record.labels, tuple) or not {*map(type, record.labels)} <= {str, np.str_}:
            raise _error(record, "labels", "not a tuple of texts; give one for each position")
        for name, row in _ROWS.items():
            _check_array(record, name, (len(record.labels), *row))
        return
    for name in _TRANSFORMS:
        T = _check_array(record, name, (4, 4))
        if T is not None:
            _check_transform(record, name, T)


def _check_array(record: m.Record, name: str, shape: tuple[int, ...]) -> Any:
    value = getattr(record, name, None)
    if value is not None and not (isinstance(value, np.ndarray) and value.dtype.kind in "fiu" and value.shape == shape):
        found = f"{value.dtype} {value.shape}" if isinstance(value, np.ndarray) else type(value).__name__
        raise _error(record, name, f"{found}; give a float64 array of shape {shape}")
    return value


def _check_transform(record: m.Record, name: str, T: Any) -> None:
    R, last = T[:3, :3].astype(np.float64), T[3].tolist()
    error = float(rotation_errors(R[None])[0])
    if np.isfinite(R).all() and error > ROTATION_TOLERANCE:
        raise _error(record, name, f"not a rotation (R^T R is off by {error:.4g}, det R = {np.linalg.det(R):.4g})")
    if last != [0.0, 0.0, 0.0, 1.0]:
        raise _error(record, name, f"a matrix with the last row {last}; give 0 0 0 1: a transform maps columns")


def _error(record: m.Record, name: str, fault: str) -> InvalidRecordError:
    return InvalidRecordError(f"{type(record).__name__} at {record.stamp_ns!r:.40} ns: {name} is {fault}")
