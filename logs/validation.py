"""The border between what a file says and what a record may hold: finite numbers, rotations, usable covariances."""

import math
import operator
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

QUATERNION_NORM_TOLERANCE = 1e-2
"""A quaternion whose norm is off by at most this was rounded and is normalised; beyond it, it is no rotation."""

ROTATION_TOLERANCE = 1e-3
"""Of the entries of R^T R of a rotation matrix: float32 and four digits stay below it."""

MAX_COORDINATE_M = 1e9
"""Positions further from the origin, beyond the moon, are mistakes; up to it, float64 still tells micrometres apart."""

LAST_NS = 2**62 - 1
"""Later times, after the year 2116, are taken for mistakes; up to it, sums and differences of two fit into 64 bits."""


class Refusal(ValueError):  # noqa: N818  it names what happens to the message
    """Values that no record may have. ``reason`` is one of a few fixed phrases to count by, ``detail`` the values."""

    def __init__(self, reason: str, detail: str = "") -> None:
        super().__init__(f"{reason} ({detail})" if detail else reason)
        self.reason = reason


def stamp_ns(seconds: int, nanoseconds: int, fallback_ns: int) -> int:
    """Nanoseconds of a split time; ``fallback_ns`` (the log time) where the sender left it at zero.

    Raises:
        Refusal: a time before zero.
        TypeError: they are no whole numbers.
    """
    total = operator.index(seconds) * 1_000_000_000 + operator.index(nanoseconds)
    if total < 0:
        raise Refusal("negative time", f"{total} ns")
    return total or fallback_ns


def transform_of(position: Any, orientation: Any) -> FloatArray:
    """``(4, 4)`` transform of a message's position in metres and its quaternion, which is normalised.

    Raises:
        Refusal: NaN or Inf, or a norm further from 1 than ``QUATERNION_NORM_TOLERANCE``.
    """
    x, y, z = place = position.x, position.y, position.z
    if not all(abs(coordinate) <= MAX_COORDINATE_M for coordinate in place):
        fault = "out of range" if all(map(math.isfinite, place)) else "not finite"
        raise Refusal(f"position is {fault}", f"x={x}, y={y}, z={z}")
    qx, qy, qz, qw = orientation.x, orientation.y, orientation.z, orientation.w
    norm = math.hypot(qx, qy, qz, qw)
    # Written so that NaN fails it.
    if not abs(norm - 1.0) <= QUATERNION_NORM_TOLERANCE:
        raise Refusal("quaternion is not a rotation", f"x={qx}, y={qy}, z={qz}, w={qw}, norm={norm}")
    qx, qy, qz, qw = qx / norm, qy / norm, qz / norm, qw / norm
    return np.array(
        [
            [1.0 - 2.0 * (qy * qy + qz * qz), 2.0 * (qx * qy - qz * qw), 2.0 * (qx * qz + qy * qw), x],
            [2.0 * (qx * qy + qz * qw), 1.0 - 2.0 * (qx * qx + qz * qz), 2.0 * (qy * qz - qx * qw), y],
            [2.0 * (qx * qz - qy * qw), 2.0 * (qy * qz + qx * qw), 1.0 - 2.0 * (qx * qx + qy * qy), z],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def quaternion_xyzw(T: FloatArray) -> tuple[float, ...]:
    """Unit quaternion (x, y, z, w), w >= 0, of the rotation of ``T`` (4, 4).

    Shepperd's method: the largest of the four components is computed first, so that no division is by a small number.
    """
    (a, b, c, _), (d, e, f, _), (g, h, i, _), _ = T.tolist()
    if a + e + i > 0.0:
        q = (h - f, c - g, d - b, 1.0 + a + e + i)
    elif a >= e and a >= i:
        q = (1.0 + a - e - i, b + d, c + g, h - f)
    elif e >= i:
        q = (b + d, 1.0 - a + e - i, f + h, c - g)
    else:
        q = (c + g, f + h, 1.0 - a - e + i, d - b)
    norm = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    if q[3] < 0.0:
        norm = -norm
    return tuple(component / norm for component in q)


def flat_array(values: Sequence[float], shape: tuple[int, ...], what: str, dtype: Any = np.float64) -> NDArray[Any]:
    """An array of ``shape`` of its numbers in a row.

    Raises:
        Refusal: another length.
    """
    count = math.prod(shape)
    if len(values) != count:
        raise Refusal("lengths disagree", f"{what}: {len(values)} numbers for {' x '.join(map(str, shape))}")
    return np.fromiter(values, dtype=dtype, count=count).reshape(shape)


def transforms(values: Sequence[float], count: int, what: str) -> FloatArray:
    """``(count, 4, 4)`` transforms of ``count`` x 12 numbers, the rows of the upper 3x4.

    Raises:
        Refusal: another length, NaN or Inf, or a rotation further from one than ``ROTATION_TOLERANCE``.
    """
    T = np.zeros((count, 4, 4))
    T[:, :3, :] = flat_array(values, (count, 3, 4), what)
    T[:, 3, 3] = 1.0
    if not np.isfinite(T).all():
        raise Refusal("transform is not finite", what)
    if (np.abs(T) > MAX_COORDINATE_M).any():
        raise Refusal("position is out of range", what)
    error = rotation_errors(T[:, :3, :3])
    if (error > ROTATION_TOLERANCE).any():
        raise Refusal("matrix is not a rotation", f"{what}: R^T R off by {error.max():.2g}")
    return T


def rotation_errors(R: FloatArray) -> FloatArray:
    """Largest entry (N,) of |R^T R - I| of matrices (N, 3, 3); infinite where one is mirrored or not finite."""
    with np.errstate(over="ignore", invalid="ignore"):
        errors = np.abs(np.swapaxes(R, -1, -2) @ R - np.eye(3)).max(axis=(-1, -2), initial=0.0)
        return np.where(np.isfinite(errors) & (np.linalg.det(R) > 0.0), errors, np.inf)


def is_rotation(rows: Sequence[Sequence[float]]) -> bool:
    """Whether the first three columns of three ``rows`` of finite numbers are a rotation, by the tolerance of
    ``rotation_errors``; of one matrix in an eighth of its time.
    """
    (a, b, c, *_), (d, e, f, *_), (g, h, i, *_) = rows
    errors = (
        a * a + d * d + g * g - 1.0,
        b * b + e * e + h * h - 1.0,
        c * c + f * f + i * i - 1.0,
        a * b + d * e + g * h,
        a * c + d * f + g * i,
        b * c + e * f + h * i,
    )
    determinant = a * (e * i - f * h) + b * (f * g - d * i) + c * (d * h - e * g)
    return max(map(abs, errors)) <= ROTATION_TOLERANCE and determinant > 0.0


def usable_covariance(P: FloatArray, counters: Counter[str]) -> FloatArray | None:
    """``P`` (n, n), symmetrised; None if all zero ("unknown"); None, counted, if not positive definite.

    A singular, absurd or infinite covariance cannot weigh a measurement, but the measurement itself is still good.
    """
    usable = usable_covariances(P[None], counters)[0]
    return usable if usable.any() else None


def usable_covariances(P: FloatArray, counters: Counter[str]) -> FloatArray:
    """``P`` (N, n, n), symmetrised; all zero ("unknown") where one is not positive definite, and counted."""
    largest = np.abs(P).max(axis=(1, 2), initial=0.0)
    finite = largest <= MAX_COORDINATE_M**2
    P = np.where(finite[:, None, None], P, 0.0)
    symmetric = 0.5 * (P + P.swapaxes(-1, -2))
    # Singular to double precision.
    good = finite & (np.linalg.eigvalsh(symmetric)[:, 0] > 1e-14 * largest)
    if ignored := int((~good & (largest != 0.0)).sum()):
        counters["ignored_covariances"] += ignored
    return np.where(good[:, None, None], symmetric, 0.0)
