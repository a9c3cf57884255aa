"""Poses with most votes by matches of two objects: a generalised Hough transform (Ballard, PR 1981).

Two matched objects determine yaw and translation. The poses of wrong matches are spread over the whole map and all
headings. Those of right matches are in one cell, or a few that adjoin, whose size is the accuracy of the pose of a
match.
"""

from __future__ import annotations

import numpy as np

from slam.common.arrays import FloatArray, IntArray
from slam.common.geometry import transform_from_xyz_yaw


def vote_for_poses(
    query_positions: FloatArray,
    reference_positions: FloatArray,
    queries: IntArray,
    references: IntArray,
    weights: FloatArray,
    *,
    tolerance_m: float,
    count: int,
) -> FloatArray:
    """The poses (H, 4, 4) of a query with most votes, at most ``count``, the best first: the mean of each cell.

    Args:
        query_positions: (N, 3) m, z up.
        reference_positions: (M, 3) m, z up.
        queries: (C, 2) rows of the query, of C matches, one at least.
        references: (C, 2) rows of the map.
        weights: (C,) of their votes.
        tolerance_m: by how much lengths of a match may differ.
        count: how many poses are wanted.
    """
    # About the middle of the query, where the noise of the headings moves it least, and near the middle of the map.
    middle, far = query_positions.mean(axis=0), reference_positions.mean(axis=0)
    query, reference = (query_positions - middle)[queries], (reference_positions - far)[references]
    q, r = (points[:, :, 0] + 1j * points[:, :, 1] for points in (query, reference))
    turns = (r[:, 1] - r[:, 0]) * (q[:, 1] - q[:, 0]).conj()
    turns /= np.maximum(np.abs(turns), np.finfo(np.float64).tiny)
    places = r.mean(axis=1) - turns * q.mean(axis=1)
    rises = (reference - query)[:, :, 2].mean(axis=1)
    # A match turns by its tolerance over its size, and moves the middle of the query by that times its distance.
    heading_rad = tolerance_m / np.median(np.abs(q[:, 1] - q[:, 0]))
    edge_m = tolerance_m + heading_rad * np.sqrt(np.mean((query_positions - middle)[:, :2] ** 2) * 2.0)
    headings = max(int(np.pi / heading_rad), 4)
    x, y = (np.floor((part - part.min()) / edge_m).astype(np.int64) for part in (places.real, places.imag))
    heading = np.floor((np.angle(turns) + np.pi) * (headings / (2.0 * np.pi))).astype(np.int64) % headings
    _, voted = np.unique((x * (y.max() + 1) + y) * headings + heading, return_inverse=True)
    totals = np.bincount(voted, weights)
    best = np.argsort(-totals, kind="stable")[:count]
    parts = np.column_stack([places.real, places.imag, rises, turns.real, turns.imag])
    means = np.column_stack([np.bincount(voted, weights * part)[best] / totals[best] for part in parts.T])
    T = transform_from_xyz_yaw(means[:, :3], np.arctan2(means[:, 4], means[:, 3]))
    T[:, :3, 3] += far - T[:, :3, :3] @ middle
    return T
