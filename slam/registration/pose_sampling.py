"""Poses of two correspondences each, drawn at random: RANSAC (Fischler and Bolles, CACM 1981), the better ones first.

In the order of PROSAC (Chum and Matas, CVPR 2005): correspondences that descriptors rank first are drawn before the
others, and the longer the drawing lasts the more of them take part, until all do, as in RANSAC. Inliers are counted by
truncated squared residuals (MSAC), and the drawing ends once a better pose would have been met with enough confidence.
"""

from __future__ import annotations

import numpy as np

from slam.common.arrays import FloatArray, IntArray
from slam.registration.parameters import RegistrationConfig
from slam.registration.pose_voting import PoseHypotheses
from slam.registration.refinement import Columns, squared_residuals, support

DRAWS = 20_000
"""Most pairs of correspondences that are drawn; after as many all take part alike."""
BATCH = 1000


def sample(columns: Columns, config: RegistrationConfig, *, rng: np.random.Generator, count: int) -> PoseHypotheses:
    """The poses with most support, at most ``config.hypotheses`` times ``count``.

    Args:
        columns: the correspondences; where one stands in the caller's list says how good descriptors find it among
            those of its object.
        config: gates and limits.
        rng: draws the pairs.
        count: how many poses are asked for.
    """
    ranked = _ranked(columns)
    poses, supports, compatible, best = [np.zeros((0, 6))], [np.zeros(0)], 0, 0.0
    for start in range(0, DRAWS, BATCH):
        first, second = _draw(len(columns), start, rng)
        drawn = _poses(columns, ranked[first], ranked[second], config)
        compatible += len(drawn)
        if len(drawn):
            found = support(squared_residuals(drawn, columns) / config.gate_sigma**2, columns)
            best = max(best, float(found.max()))
            poses.append(drawn)
            supports.append(found)
        share = min(best / len(columns), 1.0)
        if count == 1 and (1.0 - share**2) ** (start + BATCH) < 1.0 - config.confidence:
            break
    all_poses, all_supports = np.concatenate(poses), np.concatenate(supports)
    leading = np.argsort(-all_supports, kind="stable")[: config.hypotheses * count]
    return PoseHypotheses(all_poses[leading], np.rint(all_supports[leading]).astype(np.int64), compatible)


def _ranked(columns: Columns) -> IntArray:
    """Columns (P,), those that are the first of their query object in the caller's list before the second ones."""
    order = np.lexsort((columns.given, columns.query_slot))
    ranks = np.empty(len(columns), dtype=np.int64)
    ranks[order] = np.arange(len(columns)) - columns.query_starts[columns.query_slot[order]]
    return np.lexsort((columns.given, ranks))


def _draw(correspondences: int, start: int, rng: np.random.Generator) -> tuple[IntArray, IntArray]:
    """Two different places (BATCH,) in the ranking, for draws ``start`` and after."""
    draws = np.arange(start + 1, start + BATCH + 1)
    pool = np.clip(np.ceil(correspondences * np.sqrt(draws / DRAWS)), 2, correspondences).astype(np.int64)
    first = (rng.random(BATCH) * pool).astype(np.int64)
    second = (rng.random(BATCH) * (pool - 1)).astype(np.int64)
    return first, second + (second >= first)


def _poses(columns: Columns, first: IntArray, second: IntArray, config: RegistrationConfig) -> FloatArray:
    """Poses (H, 6) of the pairs of correspondences whose lengths and heights agree within the noise."""
    query = columns.query[second] - columns.query[first]
    reference = columns.reference[second] - columns.reference[first]
    query_m, reference_m = np.hypot(query[:, 0], query[:, 1]), np.hypot(reference[:, 0], reference[:, 1])
    variance = columns.sigma[first] ** 2 + columns.sigma[second] ** 2
    if config.estimate_scale:
        variance[:, 0] += 0.5 * config.scale_sigma**2 * (query_m**2 + reference_m**2)
    variance[:, 1] += config.tilt_sigma_rad**2 * 0.5 * (query_m**2 + reference_m**2)
    agree = (query_m - reference_m) ** 2 <= config.gate_sigma**2 * variance[:, 0]
    agree &= (query[:, 2] - reference[:, 2]) ** 2 <= config.gate_sigma**2 * variance[:, 1]
    agree &= np.minimum(query_m, reference_m) >= config.min_baseline_m
    agree &= columns.query_slot[first] != columns.query_slot[second]
    first, second, query, reference = first[agree], second[agree], query[agree], reference[agree]
    turn = (reference[:, 0] + 1j * reference[:, 1]) * (query[:, 0] - 1j * query[:, 1])
    rotation = turn / np.abs(turn)
    middle_query = 0.5 * (columns.query[first] + columns.query[second])
    middle_reference = 0.5 * (columns.reference[first] + columns.reference[second])
    at = middle_reference[:, 0] + 1j * middle_reference[:, 1]
    at = at - rotation * (middle_query[:, 0] + 1j * middle_query[:, 1])
    rise = middle_reference[:, 2] - middle_query[:, 2]
    return np.column_stack([rotation.real, rotation.imag, at.real, at.imag, rise, np.ones(len(turn))])
