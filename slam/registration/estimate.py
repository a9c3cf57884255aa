"""The result of a registration: the pose, its covariance and one-to-one inliers, or the reason of the failure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from slam.common.arrays import FloatArray, IntArray
from slam.common.geometry import make_transform
from slam.registration.parameters import RegistrationConfig
from slam.registration.refinement import Columns, least_squares, squared_residuals

MAX_HEADING_SIGMA_RAD = 0.2
"""A heading with a larger deviation is undetermined: its linearisation no longer holds."""
_TILT, _HEADING, _TRANSLATION = slice(0, 2), 2, slice(3, 6)


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """Pose of the query constellation in the reference, or the ``reason`` of the failure.

    ``T_reference_query`` (4, 4) carries query points, times ``scale``, into the reference frame. ``covariance`` (6, 6)
    is that of its right perturbation ``T Exp([rotation rad, translation m])``. ``pairs`` (K, 2) are the inliers, one to
    one, as (query, reference) indices by increasing query. ``score`` is the support: the sum over the inliers of 1 -
    (residual / gate)^2.
    """

    T_reference_query: FloatArray | None
    covariance: FloatArray | None
    pairs: IntArray
    score: float
    reason: str
    scale: float = 1.0

    @property
    def found(self) -> bool:
        """Whether there is a pose."""
        return self.T_reference_query is not None


def not_found(reason: str) -> Registration:
    """The answer "no", and why."""
    return Registration(None, None, np.zeros((0, 2), np.int64), 0.0, reason)


def estimate(pose: FloatArray, columns: Columns, config: RegistrationConfig) -> Registration:
    """The answer at a refined ``pose`` (6,): optimal one-to-one inliers, a last fit to them, and its covariance."""
    gate_squared = config.gate_sigma**2
    ratio = squared_residuals(pose[None], columns)[0] / gate_squared
    chosen = _assign(ratio, columns)
    if len(chosen) < config.min_inliers:
        return not_found(_too_few(len(chosen), config))
    weights = np.zeros((1, len(columns)))
    weights[0, chosen] = 1.0 - ratio[chosen] ** 2
    fitted = least_squares(pose[None], weights, columns, config)
    ratio = squared_residuals(fitted, columns)[0] / gate_squared
    chosen = chosen[ratio[chosen] < 1.0]
    if len(chosen) < config.min_inliers:
        return not_found(_too_few(len(chosen), config))
    a, b, x, y, z, scale = fitted[0].tolist()
    information = _information(scale, columns, chosen, 1.0 - ratio[chosen] ** 2, config)
    if _heading_information(information) < MAX_HEADING_SIGMA_RAD**-2:
        return not_found(f"the {len(chosen)} objects that agree are too near one another for a heading")
    R = np.array([[a, -b, 0.0], [b, a, 0.0], [0.0, 0.0, scale]]) / scale
    origin = scale * R @ columns.query_centre
    T = make_transform(R, columns.reference_centre + np.array([x, y, z]) - origin)
    covariance = _covariance(information, scale * columns.query_centre, columns.query_centre, config)
    support = float((1.0 - ratio[chosen]).sum())
    return Registration(T, covariance, columns.pairs[chosen], support, "", scale)


def _too_few(count: int, config: RegistrationConfig) -> str:
    return f"{count} pairs of objects agree on a pose, fewer than {config.min_inliers}"


def _assign(ratio: FloatArray, columns: Columns) -> IntArray:
    """Increasing indices of the one-to-one pairs with the largest sum of 1 - ``ratio`` (P,)."""
    inside = np.flatnonzero(ratio < 1.0)
    query, reference = columns.query_slot[inside], columns.reference_slot[inside]
    if len(set(query.tolist())) == len(set(reference.tolist())) == len(inside):
        return inside
    rows, row = np.unique(query, return_inverse=True)
    slots, slot = np.unique(reference, return_inverse=True)
    gain = np.zeros((len(rows), len(slots)))
    # A pair given twice has one residual, so that it does not matter which of the two is kept.
    which = np.full(gain.shape, -1, dtype=np.int64)
    gain[row, slot] = 1.0 - ratio[inside]
    which[row, slot] = inside
    chosen = which[linear_sum_assignment(gain, maximize=True)]
    return np.sort(chosen[chosen >= 0])


def _information(
    scale: float, columns: Columns, chosen: IntArray, weights: FloatArray, config: RegistrationConfig
) -> FloatArray:
    """(7, 7) of rotation, translation and scale about the centre of the query, in its axes."""
    points = columns.query[chosen]
    x, y, z = (scale * points).T
    J = np.zeros((len(points), 3, 7))
    J[:, 0, 1], J[:, 0, 2] = z, -y
    J[:, 1, 0], J[:, 1, 2] = -z, x
    J[:, 2, 0], J[:, 2, 1] = y, -x
    J[:, 0, 3] = J[:, 1, 4] = J[:, 2, 5] = 1.0
    J[:, :, 6] = points
    J *= (np.sqrt(weights)[:, None] / columns.sigma[chosen][:, [0, 0, 1]])[:, :, None]
    rows = J.reshape(-1, 7)
    information = rows.T @ rows
    information[6, 6] += config.scale_sigma**-2
    return np.asarray(information)


def _heading_information(information: FloatArray) -> float:
    """That of the heading alone, the translation marginalised. What its inverse would hold is tested before."""
    cross = information[_HEADING, _TRANSLATION]
    return float(
        information[_HEADING, _HEADING] - cross @ np.linalg.solve(information[_TRANSLATION, _TRANSLATION], cross)
    )


def _covariance(
    information: FloatArray, centre_scaled: FloatArray, centre: FloatArray, config: RegistrationConfig
) -> FloatArray:
    """(6, 6) at the query's origin from the information (7, 7) about its centre.

    Roll and pitch, which are not estimated, are nuisance parameters: their uncertainty moves the estimate of the
    others by -G times the tilt, with G from the normal equations.
    """
    free = slice(_HEADING, 7 if config.estimate_scale else 6)
    variance = config.tilt_sigma_rad**2
    inverse = np.linalg.inv(information[free, free])
    G = inverse @ information[free, _TILT]
    P = np.zeros((7, 7))
    P[free, free] = inverse + variance * G @ G.T
    P[free, _TILT] = -variance * G
    P[_TILT, free] = -variance * G.T
    P[0, 0] = P[1, 1] = variance
    # The adjoint of the translation to the centre; a larger scale moves the origin against the centre.
    x, y, z = centre_scaled.tolist()
    A = np.zeros((6, 7))
    A[:, :6] = np.eye(6)
    A[3:, :3] = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]
    A[3:, 6] = -centre
    covariance = A @ P @ A.T
    return np.asarray(0.5 * (covariance + covariance.T))
