"""Poses with most votes by matches of a few objects: a generalised Hough transform (Ballard, PR 1981).

Two matched objects determine yaw and translation. Where each object of the query has a list of candidates, all pairs of
candidates whose lengths agree are such matches: RANSAC (Fischler and Bolles, CACM 1981) that draws every pair. Quads
that are found in an index of a large map are matches of four. The poses of wrong matches are spread over the whole map
and all headings. Those of right matches are in one cell, whose size is the accuracy of the pose of a match.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam.common.arrays import ComplexArray, FloatArray, IntArray
from slam.common.geometry import transform_from_xyz_yaw
from slam.registration.parameters import RegistrationConfig
from slam.registration.refinement import Columns

MAX_CORRESPONDENCES = 3000
"""Of more than these, with 4.5 million pairs, only the likeliest make pairs."""
BLOCK_PAIRS = 2**17
"""Pairs of correspondences that are compared at once: what stays in the processor's cache."""
PAIR_TOLERANCE_SIGMAS = 2.0
"""Size of a cell for pairs. With those around it 2.1 standard deviations of the heading of a pair to either side."""
MAX_EXAMINED = 1024
"""Cells with most votes, the surroundings of which are counted."""
_OFFSETS = np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1], [-1, 0, 1], indexing="ij"), axis=-1).reshape(-1, 3)
_BITS = 21


@dataclass(frozen=True, slots=True, eq=False)
class Matches:
    """C matches of K objects each: ``query`` (C, K) rows of the query, ``reference`` (C, K) rows of the map."""

    query: IntArray
    reference: IntArray

    def __len__(self) -> int:
        return len(self.query)


def vote_for_pairs(columns: Columns, config: RegistrationConfig, *, count: int) -> FloatArray:
    """The poses (H, 4, 4), at most ``count``, with most votes of pairs of correspondences.

    They are between points about the centres of ``columns``.
    """
    pairs = _compatible_pairs(columns, config)
    tolerance_m = PAIR_TOLERANCE_SIGMAS * float(np.median(columns.sigma[:, 0]))
    return vote_for_poses(columns.query, columns.reference, Matches(pairs, pairs), tolerance_m=tolerance_m, count=count)


def vote_for_poses(
    query_positions: FloatArray,
    reference_positions: FloatArray,
    matches: Matches,
    *,
    tolerance_m: float,
    count: int,
    weights: FloatArray | None = None,
) -> FloatArray:
    """The poses (H, 4, 4) of a query with most votes, at most ``count``, the best first, no two in adjoining cells.

    Args:
        query_positions: (N, 3) m, z up.
        reference_positions: (M, 3) m, z up.
        matches: rows of both.
        tolerance_m: by how much lengths of a match may differ.
        count: how many poses are wanted.
        weights: (C,) of the votes of the matches; 1 by default.
    """
    if len(matches) == 0:
        return np.zeros((0, 4, 4))
    # About the middle of the query, where the noise of the headings moves it least, and near the middle of the map.
    middle, far = query_positions.mean(axis=0), reference_positions.mean(axis=0)
    query, reference = (query_positions - middle)[matches.query], (reference_positions - far)[matches.reference]
    radius_m = float(np.sqrt(np.mean((query_positions - middle)[:, :2] ** 2) * 2.0))
    longest_m = np.hypot(*(query[:, 1] - query[:, 0])[:, :2].T)
    turns, places = _poses(query, reference, np.arange(len(query)))
    given = np.ones(len(query)) if weights is None else weights
    votes = _Votes.of(turns, places[:, :2], given, longest_m, tolerance_m, radius_m)
    members, starts = votes.peaks(count)
    turns, places = _poses(query[members], reference[members], starts)
    T = transform_from_xyz_yaw(places, np.angle(turns))
    T[:, :3, 3] += far - T[:, :3, :3] @ middle
    return T


def _compatible_pairs(columns: Columns, config: RegistrationConfig) -> IntArray:
    """Pairs (V, 2) of correspondences whose lengths and height differences agree within the noise.

    With d the lengths, (d_q - d_r)^2 <= g^2 v is (d_q^2 - d_r^2)^2 <= g^2 v (d_q + d_r)^2, and the last factor is
    2 (d_q^2 + d_r^2) up to what the gate allows: no square root is needed.
    """
    used = _likeliest(columns)
    query, reference, sigma = columns.query[used], columns.reference[used], columns.sigma[used]
    variance, gate = sigma[:, 0] ** 2, 2.0 * config.gate_sigma**2
    scale_variance = 0.5 * config.scale_sigma**2 if config.estimate_scale else 0.0
    block = max(BLOCK_PAIRS // len(used), 1)
    pairs = []
    for start in range(0, len(used), block):
        rows = slice(start, start + block)
        squared_query, squared_reference = (_squared(points[rows], points[start:]) for points in (query, reference))
        total = squared_query + squared_reference
        allowed = (variance[rows, None] + variance[start:] + scale_variance * total) * (gate * total)
        is_compatible = np.square(squared_query - squared_reference) <= allowed
        is_compatible &= np.minimum(squared_query, squared_reference) >= config.min_baseline_m**2
        first, second = np.nonzero(np.triu(is_compatible, 1))
        pairs.append(np.column_stack([first, second]) + start)
    found = np.concatenate(pairs)
    baseline = query[found[:, 1]] - query[found[:, 0]]
    rise = reference[found[:, 1], 2] - reference[found[:, 0], 2] - baseline[:, 2]
    rise_variance = np.square(sigma[found, 1]).sum(axis=1)
    rise_variance += config.tilt_sigma_rad**2 * np.square(baseline[:, :2]).sum(axis=1)
    return np.asarray(used[found[rise * rise <= config.gate_sigma**2 * rise_variance]])


def _likeliest(columns: Columns) -> IntArray:
    """Up to ``MAX_CORRESPONDENCES`` (P,), ascending: those that stand first in the caller's list for their object."""
    if len(columns) <= MAX_CORRESPONDENCES:
        return np.arange(len(columns))
    order = np.lexsort((columns.given, columns.query_slot))
    ranks = np.empty(len(columns), dtype=np.int64)
    ranks[order] = np.arange(len(columns)) - columns.query_starts[columns.query_slot[order]]
    return np.sort(np.lexsort((columns.given, ranks))[:MAX_CORRESPONDENCES])


def _squared(first: FloatArray, second: FloatArray) -> FloatArray:
    """Squared horizontal distances (A, B) m^2 of points (A, 3) and (B, 3)."""
    x, y = (first[:, None, axis] - second[:, axis] for axis in (0, 1))
    return np.asarray(x * x + y * y)


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
