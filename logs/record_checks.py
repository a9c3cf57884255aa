"""What a program may get wrong in the records that it makes: shapes, types and transforms.

Numbers that are not finite pass: a log holds what a sensor said, and its reader leaves such messages out.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from logs import messages as m
from logs.errors import InvalidRecordError
from logs.validation import rotation_errors

ROTATION_TOLERANCE = 1e-3
"""Of the entries of R^T R: float32 and four digits stay below it."""

_SHAPES: Mapping[type, Mapping[str, tuple[int, ...]]] = {
    m.Odometry: {"T_odom_body": (4, 4)},
    m.Transform: {"T_parent_child": (4, 4)},
    m.GroundTruthPose: {"T_world_body": (4, 4)},
    m.SlamPose: {"T_map_body": (4, 4), "T_map_odom": (4, 4)},
    m.ObjectDetections: {"positions": (-1, 3), "scores": (-1,), "covariances": (-1, 3, 3), "sizes": (-1, 3)},
}
"""Of the arrays of a record; -1: a row for each label."""
_OPTIONAL = ("T_map_odom", "covariances", "sizes")


def check_record(record: m.Record) -> None:
    """See that a pose or detections have the arrays that :mod:`logs.messages` documents.

    Raises:
        InvalidRecordError: another shape or type, or a matrix that is no rigid transform; names the field and the
            remedy.
    """
    if type(record) not in _SHAPES:
        return
    if not isinstance(record.stamp_ns, int | np.integer):
        raise _error(record, "stamp_ns", f"{record.stamp_ns!r:.40}; give a whole number of nanoseconds")
    labels = record.labels if isinstance(record, m.ObjectDetections) else ()
    if not isinstance(labels, tuple) or not {*map(type, labels)} <= {str, np.str_}:
        raise _error(record, "labels", "not a tuple of texts; give one for each position")
    for name, shape in _SHAPES[type(record)].items():
        value = getattr(record, name)
        wanted = tuple(len(labels) if length == -1 else length for length in shape)
        if value is None and name in _OPTIONAL:
            continue
        if not isinstance(value, np.ndarray) or value.dtype.kind not in "fiu" or value.shape != wanted:
            found = f"{value.dtype} {value.shape}" if isinstance(value, np.ndarray) else type(value).__name__
            raise _error(record, name, f"{found}; give a float64 array of shape {wanted}")
        if shape == (4, 4):
            _check_transform(record, name, value)


def _check_transform(record: m.Record, name: str, T: Any) -> None:
    R, last = T[:3, :3].astype(np.float64), T[3].tolist()
    error = float(rotation_errors(R[None])[0])
    if np.isfinite(R).all() and error > ROTATION_TOLERANCE:
        raise _error(record, name, f"not a rotation (R^T R is off by {error:.4g}, det R = {np.linalg.det(R):.4g})")
    if last != [0.0, 0.0, 0.0, 1.0]:
        raise _error(record, name, f"a matrix with the last row {last}; give 0 0 0 1: a transform maps columns")


def _error(record: m.Record, name: str, fault: str) -> InvalidRecordError:
    return InvalidRecordError(f"{type(record).__name__} at {record.stamp_ns!r:.40} ns: {name} is {fault}")
