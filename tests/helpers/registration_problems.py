"""Problems of registration: correspondences of objects along streets, most of which may be false."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam.common.arrays import FloatArray, IntArray
from slam.common.geometry import apply, invert, rotation_angle_rad, transform_from_xyz_yaw

NOISE_M = 0.2
"""Of the query's positions, along each axis."""


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """Query (N, 3) and reference (M, 3) objects, metres; correspondences (C, 2); the truth, (4, 4)."""

    query: FloatArray
    reference: FloatArray
    correspondences: IntArray
    T_reference_query_gt: FloatArray

    def error(self, T_reference_query: FloatArray) -> tuple[float, float]:
        """Metres at the centre of the query's objects, and degrees."""
        centre = self.query.mean(axis=0, keepdims=True)
        offset = apply(T_reference_query, centre) - apply(self.T_reference_query_gt, centre)
        turn = rotation_angle_rad(invert(self.T_reference_query_gt) @ T_reference_query)
        return float(np.linalg.norm(offset)), float(np.degrees(turn))


def street_objects(count: int, *, rng: np.random.Generator) -> FloatArray:
    """Objects (``count``, 3), metres, on both sides of the streets of a square grid, a block 100 m, z up."""
    block_m, setback_m, objects_a_block = 100.0, 7.0, 16
    blocks = max(int(np.ceil(np.sqrt(count / (2 * objects_a_block)))), 1)
    along = rng.uniform(0.0, blocks * block_m, count)
    street = rng.integers(0, blocks, count) * block_m
    across = street + setback_m * rng.choice([-1.0, 1.0], count) + rng.normal(0.0, 0.5, count)
    is_east = rng.random(count) < 0.5
    planar = np.where(is_east[:, None], np.stack([along, across], axis=1), np.stack([across, along], axis=1))
    return np.column_stack([planar, rng.uniform(0.0, 3.0, count)])


def draw_problem(correspondences: int, false_share: float, *, rng: np.random.Generator) -> Problem:
    """A submap somewhere in a larger map: each true correspondence has its own objects, false ones any two."""
    true = round(correspondences * (1.0 - false_share))
    objects = max(true, correspondences // 10, 10)
    reference = street_objects(4 * objects, rng=rng)
    place = reference[rng.integers(len(reference))]
    seen = np.argsort(np.linalg.norm(reference[:, :2] - place[:2], axis=1))[:objects]
    T_reference_query = transform_from_xyz_yaw(place + rng.normal(0.0, 5.0, 3), rng.uniform(-np.pi, np.pi))
    query = apply(invert(T_reference_query), reference[seen]) + rng.normal(0.0, NOISE_M, (objects, 3))
    right = rng.permutation(objects)[:true]
    false = correspondences - true
    wrong_query = rng.integers(0, objects, false)
    # Any but the true one: as many places further on, around the end.
    wrong_reference = (seen[wrong_query] + rng.integers(1, len(reference), false)) % len(reference)
    pairs = np.concatenate([np.stack([right, seen[right]], axis=1), np.stack([wrong_query, wrong_reference], axis=1)])
    return Problem(query, reference, rng.permutation(pairs), T_reference_query)
