"""How records are made: frozen, and checked for what a program may get wrong: shapes, types and transforms.

Positions and scores that are not finite pass: such objects are left out, as those of a log.
"""

import math
from dataclasses import dataclass, field
from itertools import chain
from typing import Any, TypeVar, dataclass_transform

import numpy as np

from logs.errors import InvalidRecordError
from logs.validation import is_rotation, rotation_errors

_FRAME_FIELDS = ("frame_id", "parent_frame_id", "child_frame_id")
_T = TypeVar("_T")


@dataclass_transform(frozen_default=True, eq_default=False, field_specifiers=(field,))
def frozen(data: type[_T]) -> type[_T]:
    """A dataclass that nothing changes; two are equal only if they are one, as arrays compare by their elements."""
    return dataclass(frozen=True, slots=True, eq=False)(data)


def frames_of(record: Any) -> dict[str, str]:
    """The names of frames in a record, by the fields that hold them, a parent before its child."""
    return {name: getattr(record, name) for name in _FRAME_FIELDS if hasattr(record, name)}


def check_pose(record: Any, name: str) -> None:
    """See that the stamp, the transform ``name`` and the names of frames of a record are what it documents.

    Raises:
        InvalidRecordError: another shape or type, or a matrix that is no rigid transform; names the field and the
            remedy.
    """
    _check_stamp_and_frames(record)
    _check_array(record, name, (4, 4))
    T = getattr(record, name)
    *rows, last = T.tolist()
    if not all(map(math.isfinite, chain(*rows, last))):
        raise _error(record, name, "not finite; leave such a record out")
    if not is_rotation(rows):
        R = T[:3, :3].astype(np.float64)
        error, det = float(rotation_errors(R[None])[0]), np.linalg.det(R)
        raise _error(record, name, f"not a rotation (R^T R is off by {error:.4g}, det R = {det:.4g})")
    if last != [0.0, 0.0, 0.0, 1.0]:
        raise _error(record, name, f"a matrix with the last row {last}; give 0 0 0 1: a transform maps columns")


def check_objects(record: Any) -> None:
    """See that detections have a row of each array for each label.

    Raises:
        InvalidRecordError: another shape or type; names the field and the remedy.
    """
    _check_stamp_and_frames(record)
    labels = record.labels
    if not (isinstance(labels, tuple) and {*map(type, labels)} <= {str, np.str_}):
        raise _error(record, "labels", "not a tuple of strings; give one for each position")
    count = len(labels)
    _check_array(record, "positions", (count, 3))
    _check_array(record, "scores", (count,))
    if record.covariances is not None:
        _check_array(record, "covariances", (count, 3, 3))


def _check_stamp_and_frames(record: Any) -> None:
    if not isinstance(record.stamp_ns, int | np.integer) or abs(int(record.stamp_ns)) >= 2**63:
        raise _error(record, "stamp_ns", f"{record.stamp_ns!r:.40}; give a whole number of nanoseconds")
    for name, frame in frames_of(record).items():
        if not isinstance(frame, str):
            raise _error(record, name, f"{frame!r:.40}; give a string")


def _check_array(record: Any, name: str, shape: tuple[int, ...]) -> None:
    value = getattr(record, name)
    if not isinstance(value, np.ndarray) or value.dtype.kind not in "fiu" or value.shape != shape:
        found = f"{value.dtype} {value.shape}" if isinstance(value, np.ndarray) else type(value).__name__
        raise _error(record, name, f"{found}; give a float64 array of shape {shape}")


def _error(record: Any, name: str, fault: str) -> InvalidRecordError:
    return InvalidRecordError(f"{type(record).__name__} at {record.stamp_ns!r:.40} ns: {name} is {fault}")
