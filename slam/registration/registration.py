"""Registration of two constellations of objects from an approximate pose.

The input is two submaps: positions, their noise and labels; neither map nor graph. Association by a gate and weighted
least squares alternate; then the inliers are assigned one to one. The motion is yaw and translation, because both
frames have z up.
"""

from typing import Self

import numpy as np
from scipy.optimize import linear_sum_assignment

from logs.records import frozen
from slam.common.arrays import ComplexArray, FloatArray, IntArray
from slam.common.config import Config
from slam.common.geometry import adjoint, apply, make_transform, skew, yaw_rad
from slam.object_map.submap import Submap

MIN_OBJECTS, MIN_INLIERS = 2, 3
"""Fewest objects that determine a pose, and fewest pairs of objects that support one, unless the query has fewer."""
GATE_SIGMA = 3.0
"""Gate of residuals, in standard deviations."""
TILT_SIGMA_RAD = 0.005
"""Uncertainty of roll and pitch between the two frames."""


def search_radius_m(config: Config) -> float:
    """The initial matching distance [m]."""
    return 0.1 * config.sensor_range_m


@frozen
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

    @classmethod
    def not_found(cls, reason: str) -> Self:
        """The answer "no", and why."""
        return cls(None, None, np.zeros((0, 2), np.int64), reason)


def register(query: Submap, reference: Submap, T_initial: FloatArray, config: Config) -> Registration:
    """The pose near an approximate one at which objects of equal label meet, and which do.

    Each object pairs with the nearest one of its label, if that is mutual and inside a gate, which shrinks from
    ``search_radius_m`` to the noise; weighted least squares; and again, until nothing changes.

    Args:
        query: objects, z up; if it has fewer than ``MIN_INLIERS``, all of them have to agree.
        reference: the same of another traversal.
        T_initial: (4, 4) of the query in the reference; of its rotation only the yaw is used.
        config: lengths are fractions of its sensor range; ``objects.height_sigma_m`` is additional noise of heights.
    """
    nothing_near = Registration.not_found("no object of the query is near one of its label in the reference")
    if not len(query) or not len(reference):
        return nothing_near
    query_middle, reference_middle = query.positions.mean(axis=0), reference.positions.mean(axis=0)
    query_xyz, reference_xyz = query.positions - query_middle, reference.positions - reference_middle
    place = apply(T_initial, query_middle[None])[0] - reference_middle
    turn = np.exp(1j * yaw_rad(T_initial))
    plane, reference_plane = (points[:, 0] + 1j * points[:, 1] for points in (query_xyz, reference_xyz))
    pose = LevelPose(turn, complex(*place[:2]), place[2])
    sigma_m = np.hypot(query.sigmas.max(), reference.sigmas.max())
    # Objects farther apart are not matched while the pose is refined.
    radius_m = search_radius_m(config)
    reach_m = 2.0 * max(radius_m, GATE_SIGMA * sigma_m)
    apart_m = np.abs((turn * plane + pose.shift)[:, None] - reference_plane)
    rows = np.argwhere((apart_m <= reach_m) & (query.labels[:, None] == reference.labels))
    if not len(rows):
        return nothing_near
    q, r = rows.T
    variances = query.sigmas[q] ** 2 + reference.sigmas[r] ** 2
    # A tilt that neither frame knows of shows as a height that grows with the distance.
    height_m = config.calibration.objects.height_sigma_m
    height_m = 0.01 * config.sensor_range_m if height_m is None else height_m
    variances_z = variances + height_m**2 + (TILT_SIGMA_RAD * np.abs(plane[q])) ** 2
    pairs = Pairs(
        rows,
        plane[q],
        reference_plane[r],
        query_xyz[q, 2],
        reference_xyz[r, 2],
        np.sqrt(variances),
        np.sqrt(variances_z),
        query_middle,
        reference_middle,
    )
    least = min(max(len(query), MIN_OBJECTS), MIN_INLIERS)
    return estimate(_refine_pose(pose, pairs, radius_m), pairs, least)


@frozen
class LevelPose:
    """A pose of the query in the reference: rotation ``turn``, a complex number of length 1, then translation ``shift``
    in the plane, complex metres, and ``rise`` [m].
    """

    turn: complex
    shift: complex
    rise: float


@frozen
class Pairs:
    """P pairs of a query and a reference object.

    ``rows`` (P, 2): query and reference index. ``query`` and ``reference`` (P,): places in the plane, complex metres,
    and ``query_z``, ``reference_z`` (P,) m, about the middles (3,) m of their objects. ``sigmas`` and ``sigmas_z`` (P,)
    m: noise of the difference of the two, with an unknown tilt of the query.
    """

    rows: IntArray
    query: ComplexArray
    reference: ComplexArray
    query_z: FloatArray
    reference_z: FloatArray
    sigmas: FloatArray
    sigmas_z: FloatArray
    query_middle: FloatArray
    reference_middle: FloatArray

    def squared_residuals(self, pose: LevelPose) -> FloatArray:
        """Squared residuals (P,) at a pose, in variances."""
        apart_m = np.abs(pose.turn * self.query + pose.shift - self.reference)
        return (apart_m / self.sigmas) ** 2 + ((self.query_z + pose.rise - self.reference_z) / self.sigmas_z) ** 2

    def least_squares(self, pose: LevelPose, weights: FloatArray) -> LevelPose:
        """The pose with the least squared residuals, with ``weights`` (P,) times the inverse variances.

        The plane part is Umeyama's solution (PAMI 1991) in two dimensions, where it is a rotation for any input:
        complex numbers cannot mirror. A heading that no pair determines stays as it was; so does all without a weight.
        """
        planar, vertical = weights / self.sigmas**2, weights / self.sigmas_z**2
        total = planar.sum()
        if total == 0.0:
            return pose
        mean_query, mean_reference = planar @ self.query / total, planar @ self.reference / total
        cross = planar @ ((self.reference - mean_reference) * (self.query - mean_query).conj())
        # Below that it is rounding.
        is_turn = abs(cross) > 1e-9 * (planar @ (1.0 + np.abs(self.query) ** 2))
        turn = cross / abs(cross) if is_turn else pose.turn
        rise = vertical @ (self.reference_z - self.query_z) / vertical.sum()
        return LevelPose(turn, mean_reference - turn * mean_query, rise)


def _refine_pose(pose: LevelPose, pairs: Pairs, radius_m: float) -> LevelPose:
    """Iterate association and least squares; each pair enters if its two objects prefer it.

    The gate is halved from one iteration to the next, from ``radius_m`` to the noise. A pose that moves
    no object by more than a three-thousandth of that radius stands still.
    """
    noise_gate_m = GATE_SIGMA * pairs.sigmas.min()
    extent_m = np.abs(pairs.query).max()
    still_m = radius_m / 3000.0
    for _ in range(8):
        ratio = pairs.squared_residuals(pose) * np.minimum((pairs.sigmas / radius_m) ** 2, GATE_SIGMA**-2)
        moved = pairs.least_squares(pose, _weights(ratio, pairs.rows))
        changes_m = extent_m * abs(moved.turn - pose.turn), abs(moved.shift - pose.shift), abs(moved.rise - pose.rise)
        pose = moved
        if max(changes_m) < still_m and radius_m <= noise_gate_m:
            break
        radius_m *= 0.5
    return pose


def _weights(ratio: FloatArray, rows: IntArray) -> FloatArray:
    """Weights (P,) 1 - ratio^2 of pairs that are the best of both their objects; 0 for all others.

    Flat around zero, so that it costs hardly any efficiency, and continuous at the gate.
    """
    weights = np.maximum(1.0 - ratio * ratio, 0.0)
    for objects in rows.T:
        best = np.zeros(objects.max() + 1)
        np.maximum.at(best, objects, weights)
        weights = np.where(weights >= best[objects], weights, 0.0)
    return weights


def estimate(pose: LevelPose, pairs: Pairs, least: int) -> Registration:
    """The answer at a refined pose: optimal one-to-one inliers, ``least`` at least, a last fit, and its covariance."""
    ratio = pairs.squared_residuals(pose) / GATE_SIGMA**2
    chosen = _assign(ratio, pairs.rows)
    if len(chosen) >= least:
        weights = np.zeros(len(ratio))
        weights[chosen] = 1.0 - ratio[chosen] ** 2
        pose = pairs.least_squares(pose, weights)
        ratio = pairs.squared_residuals(pose) / GATE_SIGMA**2
        chosen = chosen[ratio[chosen] < 1.0]
    if len(chosen) < least:
        return Registration.not_found(f"{len(chosen)} pairs of objects agree on a pose, fewer than {least}")
    information = _information(pairs, chosen, 1.0 - ratio[chosen] ** 2)
    # That of the heading alone, the translation marginalised. The linearisation holds up to a deviation of 0.2 rad.
    cross = information[2, 3:]
    if information[2, 2] - cross @ np.linalg.solve(information[3:, 3:], cross) < 0.2**-2:
        return Registration.not_found(f"the {len(chosen)} objects that agree are too near one another for a heading")
    turn, place = pose.turn, [pose.shift.real, pose.shift.imag, pose.rise]
    R = np.array([[turn.real, -turn.imag, 0.0], [turn.imag, turn.real, 0.0], [0.0, 0.0, 1.0]])
    T = make_transform(R, pairs.reference_middle + place - R @ pairs.query_middle)
    # Roll and pitch, which are not estimated, are nuisance parameters: their uncertainty moves the estimate of the
    # others by -G times the tilt, with G from the normal equations.
    inverse = np.linalg.inv(information[2:, 2:])
    G = np.vstack([np.eye(2), -inverse @ information[2:, :2]])
    P = TILT_SIGMA_RAD**2 * G @ G.T
    P[2:, 2:] += inverse
    Ad = adjoint(make_transform(np.eye(3), pairs.query_middle))
    covariance = Ad @ P @ Ad.T
    return Registration(T, 0.5 * (covariance + covariance.T), pairs.rows[chosen], "")


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
    points = np.column_stack([pairs.query.real, pairs.query.imag, pairs.query_z])[chosen]
    J = np.zeros((len(chosen), 3, 6))
    J[:, :, :3], J[:, :, 3:] = -skew(points), np.eye(3)
    sigmas = np.column_stack([pairs.sigmas, pairs.sigmas, pairs.sigmas_z])[chosen]
    rows = (J * (np.sqrt(weights)[:, None] / sigmas)[:, :, None]).reshape(-1, 6)
    return rows.T @ rows
