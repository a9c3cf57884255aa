"""Votes of matched triangles for the pose of a query: a generalised Hough transform (Ballard, PR 1981).

Each pair of equal triangles is a pose. Those of wrong pairs spread over the whole map and all headings, and those of
right ones meet in a cell, whose size is how exactly a triangle determines the pose.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from slam.common.arrays import ComplexArray, FloatArray, IntArray
from slam.common.geometry import transform_from_xyz_yaw

PEAKS_EXAMINED = 16
"""Cells whose surroundings are counted, for each pose that is asked for."""
_OFFSETS = np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1], [-1, 0, 1], indexing="ij"), axis=-1).reshape(-1, 3)
_BITS = 21


class Matches(Protocol):
    """Pairs of equal polygons: ``query`` (C, K) rows of the query, ``reference`` (C, K) ids of the map, corner by
    corner.
    """

    @property
    def query(self) -> IntArray:
        """Rows (C, K) of the query."""
        ...

    @property
    def reference(self) -> IntArray:
        """Ids (C, K) of the map."""
        ...

    def __len__(self) -> int:
        """How many pairs there are."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class VotedPose:
    """``T_reference_query`` (4, 4), and the ``matches`` (K,) that voted for it."""

    T_reference_query: FloatArray
    matches: IntArray


def vote_for_poses(
    query_positions: FloatArray,
    reference_positions: FloatArray,
    matches: Matches,
    *,
    tolerance_m: float,
    count: int,
) -> list[VotedPose]:
    """The poses with most votes, at most ``count``, the best first, no two of them in adjoining cells.

    Args:
        query_positions: (N, 3) m, z up.
        reference_positions: (M, 3) m, z up, by the ids in ``matches``.
        matches: pairs of triangles.
        tolerance_m: by how much sides of a pair may differ.
        count: how many poses are wanted.
    """
    if len(matches) == 0:
        return []
    # About the middle of the query, where the noise of the headings moves it least.
    middle = query_positions.mean(axis=0)
    centred = query_positions - middle
    query = (centred[:, 0] + 1j * centred[:, 1])[matches.query]
    reference = (reference_positions[:, 0] + 1j * reference_positions[:, 1])[matches.reference]
    turns, places, longest_m = _poses(query, reference)
    votes = _Votes.of(turns, places, longest_m, tolerance_m, float(np.sqrt(np.mean(centred[:, :2] ** 2) * 2.0)))
    found = []
    for members in votes.peaks(count):
        turn, place = _mean_pose(query[members], reference[members])
        shift = place - turn * complex(middle[0], middle[1])
        rises = reference_positions[matches.reference[members], 2] - query_positions[matches.query[members], 2]
        xyz = np.array([shift.real, shift.imag, np.median(rises)])
        found.append(VotedPose(transform_from_xyz_yaw(xyz, float(np.angle(turn))), members))
    return found


def _poses(query: ComplexArray, reference: ComplexArray) -> tuple[ComplexArray, ComplexArray, FloatArray]:
    """Rotation (C,) and place (C,) m of the query's origin at which triangles (C, 3) meet, and their sizes (C,) m."""
    mean_query, mean_reference = (np.asarray(sum(each.T)) / each.shape[1] for each in (query, reference))
    about_query, about_reference = query - mean_query[:, None], reference - mean_reference[:, None]
    turns = np.einsum("ci,ci->c", about_reference, about_query.conj())
    turns /= np.maximum(np.abs(turns), np.finfo(np.float64).tiny)
    return turns, mean_reference - turns * mean_query, np.abs(query[:, 1] - query[:, 0])


def _mean_pose(query: ComplexArray, reference: ComplexArray) -> tuple[complex, complex]:
    """Least-squares rotation and place from triangles (K, 3) of one pose."""
    mean_query, mean_reference = query.mean(), reference.mean()
    turn = complex(np.sum((reference - mean_reference) * (query - mean_query).conj()))
    turn /= max(abs(turn), float(np.finfo(np.float64).tiny))
    return turn, complex(mean_reference - turn * mean_query)


@dataclass(frozen=True, slots=True, eq=False)
class _Votes:
    """``cells`` (V, 3) of x, y and heading with votes, their sorted ``keys`` (V,) and ``counts`` (V,), and the cell of
    each vote, ``voted`` (C,); ``headings``: cells of a full turn.
    """

    cells: IntArray
    keys: IntArray
    counts: IntArray
    voted: IntArray
    headings: int

    @classmethod
    def of(
        cls, turns: ComplexArray, places: ComplexArray, longest_m: FloatArray, tolerance_m: float, radius_m: float
    ) -> _Votes:
        # A triangle turns by its tolerance over its size, and moves the middle of the query by that times its distance.
        heading_rad = tolerance_m / float(np.median(longest_m))
        edge_m = tolerance_m + heading_rad * radius_m
        headings = max(int(np.pi / heading_rad), 4)
        x = np.floor((places.real - places.real.min()) / edge_m).astype(np.int64)
        y = np.floor((places.imag - places.imag.min()) / edge_m).astype(np.int64)
        heading = np.floor((np.angle(turns) + np.pi) * (headings / (2.0 * np.pi))).astype(np.int64) % headings
        keys, voted, counts = np.unique(_key(x, y, heading), return_inverse=True, return_counts=True)
        return cls(_cells(keys), keys, counts, voted, headings)

    def peaks(self, count: int) -> list[IntArray]:
        """The votes in and around the ``count`` cells with most of them there."""
        examined = np.argsort(-self.counts, kind="stable")[: PEAKS_EXAMINED * count]
        around = self._around(examined)  # (E, 27), -1 where there is no vote
        totals = np.where(around >= 0, self.counts[around], 0).sum(axis=1)
        taken = np.zeros(len(self.keys) + 1, dtype=bool)  # the last stands for cells without votes
        members = []
        for row in np.argsort(-totals, kind="stable"):
            if taken[examined[row]]:
                continue
            taken[around[row]] = True
            is_member = np.zeros(len(self.keys) + 1, dtype=bool)
            is_member[around[row]] = True
            is_member[-1] = False
            members.append(np.flatnonzero(is_member[self.voted]))
            if len(members) == count:
                break
        return members

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
