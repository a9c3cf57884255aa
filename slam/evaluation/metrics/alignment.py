"""The rigid motion that lays estimated points on true ones, by least squares."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from slam.common.arrays import FloatArray
from slam.common.errors import EvaluationError
from slam.common.geometry import transform_from_xyz_yaw

STRAIGHT_LINE_RATIO = 1e-3
"""Points whose second principal spread is below this part of the first lie on a straight line."""
STANDSTILL_M = 1e-6
"""Points that spread less than this (RMS about their mean) are one point."""


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """``T_world_map`` (4, 4) carries estimated points into the true world; ``note`` says why it is not SE(3)."""

    T_world_map: FloatArray
    kind: Literal["se3", "yaw_translation"]
    note: str = ""


def principal_spreads(points: FloatArray) -> FloatArray:
    """RMS spread (D,), metres, largest first, of the points (N, D) along their principal axes; N = 0 gives zeros."""
    if len(points) == 0:
        return np.zeros(points.shape[1])
    centred = points - points.mean(axis=0)
    variances = np.linalg.eigvalsh(centred.T @ centred / len(points))[::-1]
    return np.sqrt(np.maximum(variances, 0.0))


def align_se3(points_est: FloatArray, points_gt: FloatArray) -> Alignment:
    """Rotation and translation, no scale, that minimise the squared distances between paired points.

    Source: Umeyama, "Least-squares estimation of transformation parameters between two point patterns", PAMI 1991,
    eqs. (34)-(43) with c = 1.

    Args:
        points_est: (N, 3) float64, metres, map frame.
        points_gt: (N, 3) float64, metres, world frame.

    Raises:
        EvaluationError: fewer than three pairs, points in one place, or on a straight line (either of the two sets),
            about which the rotation would be arbitrary.
    """
    _check_pairs(points_est, points_gt, 3)
    for name, points in (("estimated", points_est), ("true", points_gt)):
        spreads = principal_spreads(points)
        if spreads[0] < STANDSTILL_M:
            raise EvaluationError(f"the {len(points)} {name} points are one point, so no rotation can be found")
        if spreads[1] < STRAIGHT_LINE_RATIO * spreads[0]:
            raise EvaluationError(
                f"the {len(points)} {name} points lie on a straight line (spread {spreads[0]:.3g} m along it, "
                f"{spreads[1]:.3g} m across), so the rotation about it is arbitrary; align yaw and translation only"
            )
    return Alignment(_fit(points_est, points_gt), "se3")


def align_yaw_translation(points_est: FloatArray, points_gt: FloatArray) -> Alignment:
    """Yaw about the common vertical and a 3-D translation (four degrees of freedom), least squares in the plane.

    Both frames must have z up. The plane part is Umeyama's (as :func:`align_se3`) in two dimensions; the height is the
    difference of the means, which is its least-squares answer.

    Args:
        points_est: (N, 3) float64, metres, map frame.
        points_gt: (N, 3) float64, metres, world frame.

    Raises:
        EvaluationError: fewer than two pairs, or points of either set above one another, which leave yaw arbitrary.
    """
    _check_pairs(points_est, points_gt, 2)
    for name, points in (("estimated", points_est), ("true", points_gt)):
        spread = principal_spreads(points[:, :2])[0]
        if spread < STANDSTILL_M:
            raise EvaluationError(
                f"the {len(points)} {name} points are within {spread:.3g} m of one another in the plane, "
                "so no heading can be found; evaluate a drive that moves"
            )
    R = _fit(points_est[:, :2], points_gt[:, :2])[:2, :2]
    turn = transform_from_xyz_yaw(np.zeros(3), float(np.arctan2(R[1, 0], R[0, 0])))
    turn[:3, 3] = points_gt.mean(axis=0) - turn[:3, :3] @ points_est.mean(axis=0)
    return Alignment(turn, "yaw_translation")


def align_path(points_est: FloatArray, points_gt: FloatArray) -> Alignment:
    """:func:`align_se3`; on a straight line, where that is ambiguous, :func:`align_yaw_translation` with a note.

    Raises:
        EvaluationError: fewer than two pairs, or the points do not move in the plane.
    """
    _check_pairs(points_est, points_gt, 2)
    spreads = [principal_spreads(points) for points in (points_est, points_gt)]
    if all(s[1] >= STRAIGHT_LINE_RATIO * s[0] and s[0] >= STANDSTILL_M for s in spreads) and len(points_est) > 2:
        return align_se3(points_est, points_gt)
    return Alignment(
        align_yaw_translation(points_est, points_gt).T_world_map,
        "yaw_translation",
        f"the path is a straight line (spread across it below {STRAIGHT_LINE_RATIO:g} of that along it), "
        "so the rotation about it is undetermined: only yaw and translation are aligned",
    )


def _check_pairs(points_est: FloatArray, points_gt: FloatArray, least: int) -> None:
    if points_est.shape != points_gt.shape or points_est.ndim != 2 or points_est.shape[1] != 3:
        raise EvaluationError(f"points of shape {points_est.shape} and {points_gt.shape} are not pairs (N, 3)")
    if len(points_est) < least:
        raise EvaluationError(f"{len(points_est)} paired points; this alignment needs at least {least}")
    if not (np.isfinite(points_est).all() and np.isfinite(points_gt).all()):
        raise EvaluationError("a point to be aligned is not finite")


def _fit(points_est: FloatArray, points_gt: FloatArray) -> FloatArray:
    """Umeyama without scale in D = 2 or 3 dimensions: homogeneous (D + 1, D + 1) from points (N, D)."""
    mean_est, mean_gt = points_est.mean(axis=0), points_gt.mean(axis=0)
    covariance = (points_gt - mean_gt).T @ (points_est - mean_est) / len(points_est)  # eq. (38)
    U, _, Vt = np.linalg.svd(covariance)
    signs = np.ones(len(covariance))
    # eq. (39, 43): the least certain direction is flipped where the best orthogonal matrix is a reflection.
    signs[-1] = np.sign(np.linalg.det(U) * np.linalg.det(Vt))
    R = (U * signs) @ Vt  # eq. (40)
    T = np.eye(len(covariance) + 1)
    T[:-1, :-1], T[:-1, -1] = R, mean_gt - R @ mean_est  # eq. (41)
    return T
