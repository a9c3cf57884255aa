"""Poses with most votes by matches of two objects: a generalised Hough transform (Ballard, PR 1981).

Two matched objects determine yaw and translation. The poses of wrong matches are spread over the whole map and all
headings. Those of right matches are in one cell, whose size is the accuracy of the pose of a match.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam.common.arrays import ComplexArray, FloatArray, IntArray
from slam.common.geometry import transform_from_xyz_yaw

MAX_EXAMINED = 1024
"""Cells with most votes, the surroundings of which are counted."""
_OFFSETS = np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1], [-1, 0, 1], indexing="ij"), axis=-1).reshape(-1, 3)
_BITS = 21


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
    """The poses (H, 4, 4) of a query with most votes, at most ``count``, the best first, no two in adjoining cells.

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
    radius_m = float(np.sqrt(np.mean((query_positions - middle)[:, :2] ** 2) * 2.0))
    longest_m = np.hypot(*(query[:, 1] - query[:, 0])[:, :2].T)
    turns, places = _poses(query, reference, np.arange(len(query)))
    votes = _Votes.of(turns, places[:, :2], weights, longest_m, tolerance_m, radius_m)
    members, starts = votes.peaks(count)
    turns, places = _poses(query[members], reference[members], starts)
    T = transform_from_xyz_yaw(places, np.angle(turns))
    T[:, :3, 3] += far - T[:, :3, :3] @ middle
    return T


def _poses(query: FloatArray, reference: FloatArray, starts: IntArray) -> tuple[ComplexArray, FloatArray]:
    """Least-squares rotations (H,) and places (H, 3) m of the query's origin.

    Pose h is that of the matches from ``starts`` (H,) on, of objects (C, K, 3) of query and map.
    """
    q, r = (points[:, :, 0] + 1j * points[:, :, 1] for points in (query, reference))
    moments = np.stack([q, r, r * q.conj(), (reference - query)[:, :, 2] + 1j], axis=2).sum(axis=1)
    sums = np.add.reduceat(moments, starts, axis=0)
    mean_q, mean_r, cross = (sums[:, :3] / sums[:, 3:].imag).T
    turns = cross - mean_r * mean_q.conj()
    turns /= np.maximum(np.abs(turns), np.finfo(np.float64).tiny)
    shift = mean_r - turns * mean_q
    return turns, np.column_stack([shift.real, shift.imag, sums[:, 3].real / sums[:, 3].imag])


@dataclass(frozen=True, slots=True, eq=False)
class _Votes:
    """``cells`` (V, 3) of x, y and heading with votes, their sorted ``keys`` (V,), ``counts`` (V,) and ``weights``
    (V,), and the cell of each vote, ``voted`` (C,); ``headings``: cells of a full turn.
    """

    cells: IntArray
    keys: IntArray
    counts: IntArray
    weights: FloatArray
    voted: IntArray
    headings: int

    @classmethod
    def of(
        cls,
        turns: ComplexArray,
        places: FloatArray,
        weights: FloatArray,
        longest_m: FloatArray,
        tolerance_m: float,
        radius_m: float,
    ) -> _Votes:
        # A match turns by its tolerance over its size, and moves the middle of the query by that times its distance.
        heading_rad = tolerance_m / float(np.median(longest_m))
        edge_m = tolerance_m + heading_rad * radius_m
        headings = max(int(np.pi / heading_rad), 4)
        x, y = np.floor((places - places.min(axis=0)) / edge_m).astype(np.int64).T
        heading = np.floor((np.angle(turns) + np.pi) * (headings / (2.0 * np.pi))).astype(np.int64) % headings
        keys, voted, counts = np.unique(_key(x, y, heading), return_inverse=True, return_counts=True)
        return cls(_cells(keys), keys, counts, np.bincount(voted, weights=weights).astype(np.float64), voted, headings)

    def peaks(self, count: int) -> tuple[IntArray, IntArray]:
        """The votes (M,) in and around the ``count`` cells with most of them there, and where each peak starts (H,)."""
        examined = np.argsort(-self.weights, kind="stable")[:MAX_EXAMINED]
        around = self._around(examined)  # (E, 27), -1 where there is no vote
        totals = np.where(around >= 0, self.weights[around], 0.0).sum(axis=1)
        taken = np.zeros(len(self.keys) + 1, dtype=bool)  # the last stands for cells without votes
        by_cell, ends = np.argsort(self.voted, kind="stable"), np.cumsum(self.counts)
        members = list[IntArray]()
        for row in np.argsort(-totals, kind="stable").tolist():
            if not taken[examined[row]]:
                taken[around[row]] = True
                cells = sorted(set(around[row].tolist()) - {-1})
                members.append(np.concatenate([by_cell[ends[each] - self.counts[each] : ends[each]] for each in cells]))
                if len(members) == count:
                    break
        return np.concatenate(members), np.cumsum([0, *(len(each) for each in members[:-1])])

    def _around(self, rows: IntArray) -> IntArray:
        """The cells (E, 27) in and around some; -1 for those without votes."""
        cells = self.cells[rows][:, None] + _OFFSETS
        keys = _key(cells[..., 0], cells[..., 1], cells[..., 2] % self.headings)
        found = np.minimum(np.searchsorted(self.keys, keys), len(self.keys) - 1)
        return np.where(self.keys[found] == keys, found, -1)


def _key(x: IntArray, y: IntArray, heading: IntArray) -> IntArray:
    return np.asarray(((x + 1 << _BITS) + y + 1 << _BITS) + heading)


def _cells(keys: IntArray) -> IntArray:
    """x, y and heading (V, 3) of keys (V,)."""
    mask = (1 << _BITS) - 1
    return np.stack([(keys >> 2 * _BITS) - 1, (keys >> _BITS & mask) - 1, keys & mask], axis=1)
