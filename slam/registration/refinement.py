"""From an approximate pose to the best one nearby: gated one-to-one association and weighted least squares.

All poses are refined at once: a pair of a query and a reference object is a column, a pose is a row. The motion is
yaw and translation, because both frames have z up.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam.common.arrays import BoolArray, FloatArray, IntArray
from slam.registration.parameters import RegistrationConfig

SHRINK = 0.5
"""The search radius shrinks by this factor from one iteration to the next."""
PRODUCT_SIZE = 2**18
"""Larger matrix products OpenBLAS spreads over threads, which wait for one another where a core is busy."""
CONVERGED_FRACTION = 5e-4
"""A pose that moves no object by more than this fraction of ``distinct_m`` stands still."""


@dataclass(frozen=True, slots=True, eq=False)
class Columns:
    """P pairs of a query and a reference object, sorted by query, with what the least squares needs of them.

    Poses are rows (H, 6) of [scale cos(yaw), scale sin(yaw), x, y, z, scale], between points with their means removed.
    """

    pairs: IntArray
    """(P, 2) query and reference index."""
    given: IntArray
    """(P,) where the pair stands in the caller's list."""
    query: FloatArray
    """(P, 3) m, about ``query_centre``."""
    reference: FloatArray
    """(P, 3) m, about ``reference_centre``."""
    sigma: FloatArray
    """(P, 2) m: horizontal and vertical noise of the difference of the two, with an unknown tilt of the query."""
    query_centre: FloatArray
    reference_centre: FloatArray
    residual_matrix: FloatArray
    """(6, 3 P): pose rows times this, minus ``residual_target`` (3 P,), are the residuals in standard deviations."""
    residual_target: FloatArray
    moment_matrix: FloatArray
    """(P, 10): weights (H, P) times this are the moments that determine the pose."""
    query_starts: IntArray
    query_slot: IntArray
    reference_order: IntArray
    reference_starts: IntArray
    reference_slot: IntArray

    def __len__(self) -> int:
        return len(self.pairs)

    def subset(self, keep: BoolArray | IntArray) -> Columns:
        """Only some of the pairs; a list of indices must increase."""
        return _columns(
            self.pairs[keep],
            self.given[keep],
            self.query[keep],
            self.reference[keep],
            self.sigma[keep],
            self.query_centre,
            self.reference_centre,
        )


def make_columns(
    query: FloatArray,
    reference: FloatArray,
    pairs: IntArray,
    query_sigmas: FloatArray,
    reference_sigmas: FloatArray,
    config: RegistrationConfig,
) -> Columns:
    """Columns of ``pairs`` (P, 2), P > 0, between points (N, 3) and (M, 3) with noise (N,) and (M,), all metres."""
    order = np.lexsort((pairs[:, 1], pairs[:, 0]))
    ordered = pairs[order]
    q, r = ordered[:, 0], ordered[:, 1]
    query_centre = np.add.reduce(query, axis=0) / len(query)
    reference_centre = np.add.reduce(reference, axis=0) / len(reference)
    variance = query_sigmas[q] ** 2 + reference_sigmas[r] ** 2
    points = query[q] - query_centre
    # A tilt that neither frame knows of shows as a height that grows with the distance.
    tilt_variance = config.tilt_sigma_rad**2 * (points[:, 0] ** 2 + points[:, 1] ** 2)
    sigma = np.sqrt(np.stack([variance, variance + config.height_sigma_m**2 + tilt_variance], axis=1))
    return _columns(ordered, order, points, reference[r] - reference_centre, sigma, query_centre, reference_centre)


def _columns(
    pairs: IntArray,
    given: IntArray,
    query: FloatArray,
    reference: FloatArray,
    sigma: FloatArray,
    query_centre: FloatArray,
    reference_centre: FloatArray,
) -> Columns:
    count = len(pairs)
    qx, qy, qz = query.T
    rx, ry, rz = reference.T
    per_h, per_v = 1.0 / sigma.T
    F = np.zeros((6, 3, count))
    F[0, 0] = F[1, 1] = qx * per_h
    F[0, 1] = qy * per_h
    F[1, 0] = -F[0, 1]
    F[2, 0] = F[3, 1] = per_h
    F[4, 2] = per_v
    F[5, 2] = qz * per_v
    target = np.concatenate([rx * per_h, ry * per_h, rz * per_v])
    G = np.stack([qx, qy, rx, ry, rx * qx + ry * qy, ry * qx - rx * qy, np.ones(count), qx * qx + qy * qy, rz, qz])
    G[:8] *= per_h * per_h
    G[8:] *= per_v * per_v
    moments = np.concatenate([G, (per_v * per_v)[None]]).T
    query_starts, query_slot = _segments(pairs[:, 0])
    reference_order = np.argsort(pairs[:, 1], kind="stable")
    reference_starts, slot = _segments(pairs[reference_order, 1])
    reference_slot = np.empty_like(slot)
    reference_slot[reference_order] = slot
    return Columns(
        pairs, given, query, reference, sigma, query_centre, reference_centre,
        F.reshape(6, 3 * count), target, np.ascontiguousarray(moments),
        query_starts, query_slot, reference_order, reference_starts, reference_slot,
    )  # fmt: skip


def _segments(sorted_ids: IntArray) -> tuple[IntArray, IntArray]:
    """Where each run of equal ids starts (S,), and the run (P,) that each element is in."""
    is_start = np.empty(len(sorted_ids), dtype=bool)
    is_start[:1] = True
    np.not_equal(sorted_ids[1:], sorted_ids[:-1], out=is_start[1:])
    return np.flatnonzero(is_start), np.cumsum(is_start) - 1


def squared_residuals(poses: FloatArray, columns: Columns) -> FloatArray:
    """(H, P) squared residuals of the pairs, in variances."""
    rows = max(PRODUCT_SIZE // columns.residual_matrix.size, 1)
    if len(poses) > rows:
        return np.concatenate(
            [squared_residuals(poses[start : start + rows], columns) for start in range(0, len(poses), rows)]
        )
    residuals = poses @ columns.residual_matrix
    residuals -= columns.residual_target
    residuals *= residuals
    count = len(columns)
    total = residuals[:, :count] + residuals[:, count : 2 * count]
    total += residuals[:, 2 * count :]
    return total


def support(ratio: FloatArray, columns: Columns) -> FloatArray:
    """(H,) sum of 1 - ``ratio`` (H, P) over the pairs inside the gate; nearly one to one.

    Each query object counts once, with its best pair, and each reference object likewise: both are upper bounds of the
    optimal assignment, and the smaller one is returned.
    """
    weight = np.maximum(1.0 - ratio, 0.0)
    if len(columns.query_starts) == len(columns.reference_starts) == len(columns):
        return np.asarray(weight.sum(axis=1))
    by_query = np.maximum.reduceat(weight, columns.query_starts, axis=1).sum(axis=1)
    by_reference = np.maximum.reduceat(weight[:, columns.reference_order], columns.reference_starts, axis=1).sum(axis=1)
    return np.asarray(np.minimum(by_query, by_reference))


def refine_poses(
    poses: FloatArray, columns: Columns, config: RegistrationConfig, *, radius_m: float
) -> tuple[FloatArray, Columns]:
    """Iterate association and least squares from the poses (H, 6); each pair enters if its two objects prefer it.

    The gate shrinks from ``radius_m`` to the noise. Returns the poses and the columns that are near any of them.
    """
    gate_squared = config.gate_sigma**2
    noise_gate_m = config.gate_sigma * float(columns.sigma[:, 0].min())
    extent_m = float(np.abs(columns.query[:, :2]).max())
    leverage = np.array([extent_m, extent_m, 1.0, 1.0, 1.0, extent_m])
    for iteration in range(config.max_iterations):
        radius = radius_m * SHRINK**iteration
        ratio = squared_residuals(poses, columns)
        if iteration == 0:
            # What is two radii away now comes within reach only of a pose that moves by more than a radius.
            near = ratio.min(axis=0) < np.maximum((2.0 * radius_m / columns.sigma[:, 0]) ** 2, 4.0 * gate_squared)
            if not near.any():
                return poses, columns
            if 4 * int(near.sum()) < 3 * len(columns):
                columns, ratio = columns.subset(near), ratio[:, near]
        ratio *= np.minimum((columns.sigma[:, 0] / radius) ** 2, 1.0 / gate_squared)
        moved = least_squares(poses, _weights(ratio, columns), columns, config)
        change_m = float((np.abs(moved - poses) * leverage).max())
        poses = moved
        if change_m < CONVERGED_FRACTION * config.distinct_m and radius <= noise_gate_m:
            break
    return poses, columns


def _weights(ratio: FloatArray, columns: Columns) -> FloatArray:
    """(H, P) weights 1 - ratio^2 of pairs that are the best of both their objects; 0 for all others.

    Flat around zero, so that it costs hardly any efficiency, and continuous at the gate.
    """
    weight = np.maximum(1.0 - ratio * ratio, 0.0)
    if len(columns.query_starts) < len(columns):
        best = np.maximum.reduceat(weight, columns.query_starts, axis=1)
        weight *= weight >= best[:, columns.query_slot]
    if len(columns.reference_starts) < len(columns):
        best = np.maximum.reduceat(weight[:, columns.reference_order], columns.reference_starts, axis=1)
        weight *= weight >= best[:, columns.reference_slot]
    return weight


def least_squares(poses: FloatArray, weights: FloatArray, columns: Columns, config: RegistrationConfig) -> FloatArray:
    """Poses (H, 6) that minimise the squared residuals with ``weights`` (H, P) times the inverse variances.

    The plane part is Umeyama's solution (PAMI 1991) in two dimensions, where it is a rotation for any input: complex
    numbers cannot mirror. A heading that no pair determines stays as in ``poses``; so does all where no weight is.
    """
    moments = weights @ columns.moment_matrix
    weight = moments[:, 6]
    weighed = weight > 0.0
    if not weighed.all():
        result = poses.copy()
        result[weighed] = least_squares(poses[weighed], weights[weighed], columns, config) if weighed.any() else 0.0
        return result
    planar = moments[:, :6].view(np.complex128)
    mean_query = planar[:, 0] / weight
    covariance = planar[:, 2] - planar[:, 1] * mean_query.conj()
    length = np.abs(covariance)
    spread = moments[:, 7] - (planar[:, 0] * mean_query.conj()).real
    scale = np.ones(len(poses))
    if config.estimate_scale:
        prior = config.scale_sigma**-2
        scale = (length + prior) / (spread + prior)
    turns = length > 1e-9 * (moments[:, 7] + weight * (0.5 * config.distinct_m) ** 2)  # below that it is rounding
    if not turns.all():
        before = poses[:, :2].copy().view(np.complex128)[:, 0] / poses[:, 5]
        covariance, length = np.where(turns, covariance, before), np.where(turns, length, 1.0)
    rotation = covariance / length * scale
    result = np.empty_like(poses)
    plane = result[:, :4].view(np.complex128)
    plane[:, 0] = rotation
    plane[:, 1] = planar[:, 1] / weight - rotation * mean_query
    result[:, 4] = (moments[:, 8] - scale * moments[:, 9]) / moments[:, 10]
    result[:, 5] = scale
    return result
