"""The result of a registration: the pose, its covariance and one-to-one inliers, or the reason of the failure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from slam.common.arrays import FloatArray, IntArray
from slam.common.geometry import adjoint, make_transform
from slam.registration.parameters import RegistrationConfig
from slam.registration.refinement import LevelPose, Pairs


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """Pose of the query constellation in the reference, or the ``reason`` of the failure.

    ``T_reference_query`` (4, 4) carries query points into the reference frame. ``covariance`` (6, 6) is that of its
    right perturbation ``T Exp([rotation rad, translation m])``. ``pairs`` (K, 2) are the inliers, one to one, as
    (query, reference) indices by increasing query.
    """

    T_reference_query: FloatArray | None
    covariance: FloatArray | None
    pairs: IntArray
    reason: str


def not_found(reason: str) -> Registration:
    """The answer "no", and why."""
    return Registration(None, None, np.zeros((0, 2), np.int64), reason)


def estimate(pose: LevelPose, pairs: Pairs, config: RegistrationConfig) -> Registration:
    """The answer at a refined pose: optimal one-to-one inliers, a last fit to them, and its covariance."""
    ratio = pairs.squared_residuals(pose) / config.gate_sigma**2
    chosen = _assign(ratio, pairs.rows)
    if len(chosen) < config.min_inliers:
        return not_found(_too_few(len(chosen), config))
    weights = np.zeros(len(ratio))
    weights[chosen] = 1.0 - ratio[chosen] ** 2
    fitted = pairs.least_squares(pose, weights)
    ratio = pairs.squared_residuals(fitted) / config.gate_sigma**2
    chosen = chosen[ratio[chosen] < 1.0]
    if len(chosen) < config.min_inliers:
        return not_found(_too_few(len(chosen), config))
    information = _information(pairs, chosen, 1.0 - ratio[chosen] ** 2)
    # That of the heading alone, the translation marginalised. The linearisation holds up to a deviation of 0.2 rad.
    cross = information[2, 3:]
    if information[2, 2] - cross @ np.linalg.solve(information[3:, 3:], cross) < 0.2**-2:
        return not_found(f"the {len(chosen)} objects that agree are too near one another for a heading")
    turn, place = fitted.turn, [fitted.shift.real, fitted.shift.imag, fitted.rise]
    R = np.array([[turn.real, -turn.imag, 0.0], [turn.imag, turn.real, 0.0], [0.0, 0.0, 1.0]])
    T = make_transform(R, pairs.reference_middle + place - R @ pairs.query_middle)
    covariance = _covariance(information, pairs.query_middle, config.tilt_sigma_rad**2)
    return Registration(T, covariance, pairs.rows[chosen], "")


def _too_few(count: int, config: RegistrationConfig) -> str:
    return f"{count} pairs of objects agree on a pose, fewer than {config.min_inliers}"


def _assign(ratio: FloatArray, rows: IntArray) -> IntArray:
    """Increasing indices of the one-to-one pairs with the largest sum of 1 - ``ratio`` (P,)."""
    inside = np.flatnonzero(ratio < 1.0)
    (queries, query), (references, reference) = (np.unique(side, return_inverse=True) for side in rows[inside].T)
    gain = np.zeros((len(queries), len(references)))
    which = np.full(gain.shape, -1, dtype=np.int64)
    gain[query, reference] = 1.0 - ratio[inside]
    which[query, reference] = inside
    chosen = which[linear_sum_assignment(gain, maximize=True)]
    return np.sort(chosen[chosen >= 0])


def _information(pairs: Pairs, chosen: IntArray, weights: FloatArray) -> FloatArray:
    """(6, 6) of rotation and translation about the middle of the query, in its axes."""
    x, y, z = pairs.query.real[chosen], pairs.query.imag[chosen], pairs.query_z[chosen]
    J = np.zeros((len(chosen), 3, 6))
    J[:, 0, 1], J[:, 0, 2] = z, -y
    J[:, 1, 0], J[:, 1, 2] = -z, x
    J[:, 2, 0], J[:, 2, 1] = y, -x
    J[:, 0, 3] = J[:, 1, 4] = J[:, 2, 5] = 1.0
    sigmas = np.column_stack([pairs.sigmas, pairs.sigmas, pairs.sigmas_z])[chosen]
    rows = (J * (np.sqrt(weights)[:, None] / sigmas)[:, :, None]).reshape(-1, 6)
    return np.asarray(rows.T @ rows)


def _covariance(information: FloatArray, middle: FloatArray, tilt_variance: float) -> FloatArray:
    """(6, 6) at the query's origin from the information (6, 6) about its middle.

    Roll and pitch, which are not estimated, are nuisance parameters: their uncertainty moves the estimate of the
    others by -G times the tilt, with G from the normal equations.
    """
    inverse = np.linalg.inv(information[2:, 2:])
    G = np.vstack([np.eye(2), -inverse @ information[2:, :2]])
    P = tilt_variance * G @ G.T
    P[2:, 2:] += inverse
    Ad = adjoint(make_transform(np.eye(3), middle))
    covariance = Ad @ P @ Ad.T
    return np.asarray(0.5 * (covariance + covariance.T))
