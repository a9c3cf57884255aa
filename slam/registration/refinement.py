"""From an approximate pose to the best one nearby: gated one-to-one association and weighted least squares.

The motion is yaw and translation, because both frames have z up.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam.common.arrays import ComplexArray, FloatArray, IntArray
from slam.registration.parameters import RegistrationConfig

MAX_ITERATIONS = 8


@dataclass(frozen=True, slots=True, eq=False)
class LevelPose:
    """A pose of the query in the reference: rotation ``turn``, a complex number of length 1, then translation ``shift``
    in the plane, complex metres, and ``rise`` [m].
    """

    turn: complex
    shift: complex
    rise: float


@dataclass(frozen=True, slots=True, eq=False)
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
        return np.asarray(
            (apart_m / self.sigmas) ** 2 + ((self.query_z + pose.rise - self.reference_z) / self.sigmas_z) ** 2
        )

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
        return LevelPose(complex(turn), complex(mean_reference - turn * mean_query), float(rise))


def refine_pose(pose: LevelPose, pairs: Pairs, config: RegistrationConfig) -> LevelPose:
    """Iterate association and least squares; each pair enters if its two objects prefer it.

    The gate is halved from one iteration to the next, from ``config.search_radius_m`` to the noise. A pose that moves
    no object by more than a three-thousandth of that radius stands still.
    """
    noise_gate_m = config.gate_sigma * float(pairs.sigmas.min())
    extent_m = float(np.abs(pairs.query).max())
    radius_m = config.search_radius_m
    for _ in range(MAX_ITERATIONS):
        ratio = pairs.squared_residuals(pose) * np.minimum((pairs.sigmas / radius_m) ** 2, config.gate_sigma**-2)
        moved = pairs.least_squares(pose, _weights(ratio, pairs.rows))
        changes_m = extent_m * abs(moved.turn - pose.turn), abs(moved.shift - pose.shift), abs(moved.rise - pose.rise)
        pose = moved
        if max(changes_m) < config.search_radius_m / 3000.0 and radius_m <= noise_gate_m:
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
