"""Registration of two constellations of objects: from correspondences, or from an approximate pose.

The input is positions, their noise, and which objects may be the same; neither map nor graph.
"""

from __future__ import annotations

from itertools import chain

import numpy as np
from scipy.spatial import cKDTree

from slam.common.arrays import ComplexArray, FloatArray, IntArray
from slam.registration.estimate import Registration, estimate, not_found
from slam.registration.parameters import RegistrationConfig
from slam.registration.pose_voting import vote_for_pairs
from slam.registration.refinement import Columns, make_columns, refine_poses, squared_residuals, support

__all__ = ["Registration", "refine", "register"]

VOTED_PER_RESULT = 16
"""Poses with most votes that are scored for each result."""
REFINED_PER_RESULT = 8
"""Distinct poses that are refined for each result."""
REACH_RADII = 2.0
"""Objects that are so many search radii, or gates, apart are not matched in a refinement."""
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
    """
    if not len(correspondences):
        return [not_found("there are no correspondences")]
    columns = make_columns(
        query_positions, reference_positions, correspondences, query_sigmas, reference_sigmas, config
    )
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
    """The pose near an approximate one at which objects of equal label meet, and which do.

    Each object pairs with the nearest one of its label, if that is mutual and inside a gate, which shrinks from
    ``config.search_radius_m`` to the noise; weighted least squares; and again, until nothing changes.

    Args:
        query_positions: (N, 3) m, z up.
        query_labels: (N,) int64.
        reference_positions: (M, 3) m, z up.
        reference_labels: (M,) int64.
        T_initial: (4, 4) of the query in the reference; of its rotation only the yaw is used.
        config: gates and limits.
        query_sigmas: (N,) m, noise of a position along any axis.
        reference_sigmas: (M,) m.
    """
    pairs = np.zeros((0, 2), dtype=np.int64)
    if len(query_positions) and len(reference_positions):
        sigma_m = float(np.hypot(query_sigmas.max(), reference_sigmas.max()))
        reach_m = REACH_RADII * max(config.search_radius_m, config.gate_sigma * sigma_m)
        pairs = _pairs_within(query_positions, reference_positions, T_initial, reach_m)
        pairs = pairs[query_labels[pairs[:, 0]] == reference_labels[pairs[:, 1]]]
    if not len(pairs):
        return not_found("no object of the query is near one of its label in the reference")
    columns = make_columns(query_positions, reference_positions, pairs, query_sigmas, reference_sigmas, config)
    place = T_initial[:3, :3] @ columns.query_centre + T_initial[:3, 3] - columns.reference_centre
    poses = _rows(T_initial[None], place[None])
    poses, near = refine_poses(poses, columns, config, radius_m=config.search_radius_m)
    return estimate(poses[0], near, config)


def _pairs_within(
    query_positions: FloatArray, reference_positions: FloatArray, T_initial: FloatArray, reach_m: float
) -> IntArray:
    """Pairs (P, 2) that are so near at a pose (4, 4), upright about the centre of the query."""
    centre = query_positions.mean(axis=0)
    middle = T_initial[:3, :3] @ centre + T_initial[:3, 3]
    offsets = (query_positions - centre)[:, :2] @ np.array([1.0, 1.0j])
    moved = complex(*middle[:2]) + _headings(T_initial[None])[0] * offsets
    near = cKDTree(reference_positions[:, :2]).query_ball_point(np.column_stack([moved.real, moved.imag]), reach_m)
    query = np.repeat(np.arange(len(near)), [len(objects) for objects in near])
    return np.column_stack([query, np.fromiter(chain.from_iterable(near), dtype=np.int64, count=len(query))])


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
