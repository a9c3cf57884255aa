"""Where a constellation of objects lies in another one: from correspondences, or from an approximate pose.

Knows neither map nor graph: positions, their noise, and which objects may be the same.
"""

from __future__ import annotations

from itertools import chain

import numpy as np
from scipy.spatial import cKDTree

from slam.common.arrays import ComplexArray, FloatArray, IntArray
from slam.common.errors import GeometryError
from slam.registration.estimate import Registration, estimate, not_found
from slam.registration.parameters import RegistrationConfig
from slam.registration.pose_voting import vote_for_pairs
from slam.registration.refinement import Columns, make_columns, refine_poses, squared_residuals, support

__all__ = ["Registration", "refine", "refine_many", "register"]

VOTED_PER_RESULT = 16
"""Poses with most votes that are scored for each result."""
REFINED_PER_RESULT = 8
"""Distinct poses that are refined for each result."""
REACH_RADII = 2.0
"""Objects that many search radii, or gates, from one another are no pair of a refinement."""
VOTED_RADIUS_SIGMAS = 2.0
"""How far a voted pose looks for partners at first, in gates."""


def register(
    query_positions: FloatArray,
    reference_positions: FloatArray,
    correspondences: IntArray,
    config: RegistrationConfig,
    *,
    query_sigmas: FloatArray,
    reference_sigmas: FloatArray,
    count: int = 1,
) -> list[Registration]:
    """Poses of the query in the reference that many one-to-one correspondences support.

    All compatible pairs of correspondences vote (:mod:`slam.registration.pose_voting`). The poses with most votes are
    scored by truncated squared residuals (MSAC: Torr and Zisserman, CVIU 2000); the best distinct ones are refined and
    assigned one to one.

    Args:
        query_positions: (N, 3) m, z up.
        reference_positions: (M, 3) m, z up.
        correspondences: (C, 2) query and reference index of objects that may be the same, the likelier ones of a query
            object first.
        config: gates and limits.
        query_sigmas: (N,) m, noise of a position along any axis.
        reference_sigmas: (M,) m.
        count: most poses that are returned.

    Returns:
        One to ``count`` poses, best first, no two of them near each other; or one answer "no" with its reason.

    Raises:
        GeometryError: arrays that do not fit together, indices out of range, or values that are not finite.
    """
    pairs = np.asarray(correspondences, dtype=np.int64).reshape(-1, 2)
    _check("query", query_positions, query_sigmas, pairs[:, 0])
    _check("reference", reference_positions, reference_sigmas, pairs[:, 1])
    if len(pairs) == 0:
        return [not_found("there are no correspondences")]
    columns = make_columns(query_positions, reference_positions, pairs, query_sigmas, reference_sigmas, config)
    reason = _degenerate(columns, config)
    if reason:
        return [not_found(reason)]
    voted = vote_for_pairs(columns, config, count=VOTED_PER_RESULT * count)
    if len(voted) == 0:
        return [not_found("no two correspondences have the same length, height difference and a sufficient baseline")]
    poses, bounds = _ranked(_rows(voted, voted[:, :3, 3]), columns, config)
    poses = poses[_distinct(poses, config, REFINED_PER_RESULT * count)]
    radius = VOTED_RADIUS_SIGMAS * config.gate_sigma * float(columns.sigma[:, 0].mean())
    poses, near = refine_poses(poses, columns, config, radius_m=radius)
    poses, bounds = _ranked(poses, near, config)
    leaders = _distinct(poses, config, len(poses))
    return _best(poses[leaders], bounds[leaders], near, config, count)


def refine(
    query_positions: FloatArray,
    query_labels: IntArray,
    reference_positions: FloatArray,
    reference_labels: IntArray,
    T_initial: FloatArray,
    config: RegistrationConfig,
    *,
    query_sigmas: FloatArray,
    reference_sigmas: FloatArray,
) -> Registration:
    """:func:`refine_many` from the one pose ``T_initial`` (4, 4)."""
    return refine_many(
        query_positions,
        query_labels,
        reference_positions,
        reference_labels,
        T_initial[None],
        config,
        query_sigmas=query_sigmas,
        reference_sigmas=reference_sigmas,
    )[0]


def refine_many(
    query_positions: FloatArray,
    query_labels: IntArray,
    reference_positions: FloatArray,
    reference_labels: IntArray,
    T_initial: FloatArray,
    config: RegistrationConfig,
    *,
    query_sigmas: FloatArray,
    reference_sigmas: FloatArray,
) -> list[Registration]:
    """The pose near each approximate one at which objects of equal label meet, and which do.

    Each object pairs with the nearest one of its label, if that is mutual and inside a gate, which shrinks from
    ``config.search_radius_m`` to the noise; weighted least squares; and again, until nothing changes.

    Args:
        query_positions: (N, 3) m, z up.
        query_labels: (N,) int64.
        reference_positions: (M, 3) m, z up.
        reference_labels: (M,) int64.
        T_initial: (H, 4, 4) of the query in the reference; of its rotation only the yaw is used.
        config: gates and limits.
        query_sigmas: (N,) m, noise of a position along any axis.
        reference_sigmas: (M,) m.

    Returns:
        One answer for each initial pose, in its order.

    Raises:
        GeometryError: arrays that do not fit together or values that are not finite.
    """
    T_initial = np.asarray(T_initial, dtype=np.float64)
    if T_initial.ndim != 3 or T_initial.shape[1:] != (4, 4) or not np.isfinite(T_initial).all():
        raise GeometryError(f"initial poses of shape {T_initial.shape} are not (H, 4, 4), or not finite")
    _check("query", query_positions, query_sigmas, np.zeros(0, np.int64), len(query_labels))
    _check("reference", reference_positions, reference_sigmas, np.zeros(0, np.int64), len(reference_labels))
    if len(T_initial) == 0:
        return []
    pairs = _near_pairs(
        query_positions,
        reference_positions,
        T_initial,
        config,
        query_sigmas=query_sigmas,
        reference_sigmas=reference_sigmas,
    )
    pairs = pairs[np.asarray(query_labels)[pairs[:, 0]] == np.asarray(reference_labels)[pairs[:, 1]]]
    if len(pairs) == 0:
        return [not_found("no object of the query is near one of its label in the reference")] * len(T_initial)
    columns = make_columns(query_positions, reference_positions, pairs, query_sigmas, reference_sigmas, config)
    poses = _pose_rows(T_initial, columns)
    poses, near = refine_poses(poses, columns, config, radius_m=config.search_radius_m)
    results = [estimate(pose, near, config) for pose in poses]
    return [
        Registration(r.T_reference_query, r.covariance, np.arange(len(r.pairs)), r.pairs, r.score, r.reason, r.scale)
        for r in results
    ]


def _near_pairs(
    query_positions: FloatArray,
    reference_positions: FloatArray,
    T_initial: FloatArray,
    config: RegistrationConfig,
    *,
    query_sigmas: FloatArray,
    reference_sigmas: FloatArray,
) -> IntArray:
    """Pairs (P, 2) that are so near at one of the poses (H, 4, 4) that its refinement can come to use them."""
    if len(query_positions) == 0 or len(reference_positions) == 0:
        return np.zeros((0, 2), dtype=np.int64)
    sigma_m = float(np.hypot(query_sigmas.max(), reference_sigmas.max()))
    reach_m = REACH_RADII * max(config.search_radius_m, config.gate_sigma * sigma_m)
    centre = query_positions.mean(axis=0)
    middles = T_initial[:, :3, :3] @ centre + T_initial[:, :3, 3]
    offsets = query_positions - centre
    moved = np.multiply.outer(_headings(T_initial), offsets[:, 0] + 1j * offsets[:, 1])
    moved += (middles[:, 0] + 1j * middles[:, 1])[:, None]
    points = np.column_stack([moved.real.ravel(), moved.imag.ravel()])
    near = cKDTree(reference_positions[:, :2]).query_ball_point(points, reach_m)
    query = np.repeat(np.tile(np.arange(len(offsets)), len(T_initial)), [len(objects) for objects in near])
    reference = np.fromiter(chain.from_iterable(near), dtype=np.int64, count=len(query))
    keys = np.unique(query * len(reference_positions) + reference)
    return np.stack(np.divmod(keys, len(reference_positions)), axis=1)


def _check(name: str, positions: FloatArray, sigmas: FloatArray, indices: IntArray, labels: int | None = None) -> None:
    count = len(positions)
    if positions.ndim != 2 or positions.shape[1] != 3 or sigmas.shape != (count,) or labels not in (None, count):
        raise GeometryError(
            f"{name}: positions {positions.shape}, sigmas {sigmas.shape} and {labels} labels do not fit; "
            "give (N, 3), (N,) and N"
        )
    if not np.isfinite(positions).all():
        raise GeometryError(f"{name}: a position is not finite")
    if not (np.isfinite(sigmas).all() and (sigmas > 0.0).all()):
        raise GeometryError(f"{name}: a sigma is not finite and positive")
    if len(indices) and (indices.min() < 0 or indices.max() >= count):
        raise GeometryError(f"{name}: correspondences name {indices.min()} to {indices.max()} of {count} objects")


def _degenerate(columns: Columns, config: RegistrationConfig) -> str:
    """Why no pair of correspondences can determine a pose, or ""."""
    sides = (
        ("query", columns.query, columns.query_starts),
        ("reference", columns.reference[columns.reference_order], columns.reference_starts),
    )
    for name, points, starts in sides:
        if len(starts) < 2:
            return f"all correspondences are of one {name} object; a heading needs two"
        extent = float(np.linalg.norm(np.ptp(points[:, :2], axis=0)))
        if extent < config.min_baseline_m:
            return (
                f"the {len(starts)} {name} objects are within {extent:.2f} m of one another; "
                f"a heading needs {config.min_baseline_m:g} m"
            )
    fewer = min(len(columns.query_starts), len(columns.reference_starts))
    return "" if fewer >= config.min_inliers else f"only {fewer} objects have correspondences"


def _pose_rows(T: FloatArray, columns: Columns) -> FloatArray:
    """Rows (H, 6) of level poses that carry the query's centre where the transforms (H, 4, 4) do."""
    return _rows(T, T[:, :3, :3] @ columns.query_centre + T[:, :3, 3] - columns.reference_centre)


def _rows(T: FloatArray, places: FloatArray) -> FloatArray:
    """Rows (H, 6) of level poses with the headings of transforms (H, 4, 4) and ``places`` (H, 3) m."""
    heading = _headings(T)
    return np.column_stack([heading.real, heading.imag, places, np.ones(len(T))])


def _headings(T: FloatArray) -> ComplexArray:
    """Rotations (H,) about z, of length 1, that are nearest to those of the transforms (H, 4, 4)."""
    heading = T[:, 0, 0] + T[:, 1, 1] + 1j * (T[:, 1, 0] - T[:, 0, 1])
    length = np.abs(heading)
    return np.asarray(np.where(length > 0.0, heading, 1.0) / np.where(length > 0.0, length, 1.0))


def _ranked(poses: FloatArray, columns: Columns, config: RegistrationConfig) -> tuple[FloatArray, FloatArray]:
    """Poses (H, 6), best supported first, and that support (H,); ties keep their order."""
    supports = support(squared_residuals(poses, columns) / config.gate_sigma**2, columns)
    order = np.argsort(-supports, kind="stable")
    return poses[order], supports[order]


def _distinct(poses: FloatArray, config: RegistrationConfig, most: int) -> IntArray:
    """Indices of the first ``most`` poses (H, 6), best first, that are not near a better one which is kept."""
    plane = np.ascontiguousarray(poses[:, :4]).view(np.complex128)
    turn, place = plane[:, 0], plane[:, 1]
    near = np.abs(place[:, None] - place) <= config.distinct_m
    cosine = (turn[:, None] * turn.conj()).real / (poses[:, 5, None] * poses[:, 5])
    near &= cosine >= np.cos(np.radians(config.distinct_deg))
    kept: list[int] = []
    free = np.ones(len(poses), dtype=bool)
    while len(kept) < most and free.any():
        leader = int(free.argmax())
        kept.append(leader)
        free &= ~near[leader]
        free[leader] = False
    return np.array(kept, dtype=np.int64)


def _best(
    poses: FloatArray, bounds: FloatArray, columns: Columns, config: RegistrationConfig, count: int
) -> list[Registration]:
    """The ``count`` best answers at distinct poses (H, 6), sorted by the upper ``bounds`` (H,) of their support."""
    found: list[Registration] = []
    reason = ""
    for pose, bound in zip(poses, bounds, strict=True):
        if len(found) >= count and bound <= found[count - 1].score:
            break
        answer = estimate(pose, columns, config)
        if answer.found:
            found = sorted([*found, answer], key=lambda a: -a.score)
        reason = reason or answer.reason
    return found[:count] or [not_found(reason)]
