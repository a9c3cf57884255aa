"""Geometric hashing of quads (Lamdan and Wolfson, ICCV 1988): where in a map of any size four objects may be.

Quads of a map are sorted by the cell that their five lengths and four classes fall into. Those that a quad of the
query may be are in a few of these cells, however large the map is, and so is the time to find them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from slam.common.arrays import FloatArray, IntArray
from slam.place_recognition.quads import canonical_quads, neighbour_sets, possible_quads
from slam.registration.pose_voting import Matches, vote_for_poses

CELL_SPACINGS = 0.15
"""Edge of a cell, in median distances of an object to its nearest neighbour: finer cells are empty, ..."""
CELL_SIGMAS = 4.0
"""... but not smaller than that many standard deviations of a position of the map."""
TOLERANCE_SIGMAS = 1.8
"""By how much a length may differ, in standard deviations of a coordinate of an object."""
BUDGET = 100_000
"""Quads of the map that are compared for a query. Those quads of it with the fewest candidates, which tell most, come
first."""
CHUNK = 50_000
"""Objects whose quads are made at a time."""
MAX_CELLS = 3
"""Cells along each length that are looked into."""
_PAGE_BYTES = 4096
_PRIMES = np.array(
    [
        0x9E3779B97F4A7C15,
        0xC2B2AE3D27D4EB4F,
        0x165667B19E3779F9,
        0xD6E8FEB86659FD93,
        0xA0761D6478BD642F,
        0xE7037ED1A0B428DB,
        0x8EBC6AF09C88C6E3,
        0x589965CC75374CC3,
        0x1D8E4E27C47D124F,
    ],
    dtype=np.uint64,
)


@dataclass(frozen=True, slots=True, eq=False)
class QuadIndex:
    """Quads of a map. ``vertices`` (Q, 4) uint32 by bucket; ``starts`` (B + 1,) uint32, the first of each bucket, a
    power of two of them; ``cell_m``.
    """

    vertices: NDArray[np.uint32]
    starts: NDArray[np.uint32]
    cell_m: float

    def __len__(self) -> int:
        return len(self.vertices)

    def read_ahead(self) -> None:
        """Read each page of an index that lies in a file once, so that no query waits for them."""
        for array in (self.vertices, self.starts):
            array.ravel()[:: _PAGE_BYTES // array.itemsize].sum()

    def find_poses(
        self,
        positions: FloatArray,
        labels: IntArray,
        map_positions: FloatArray,
        *,
        sigma_m: float,
        count: int,
        is_excluded: Callable[[IntArray], NDArray[np.bool_]] | None = None,
    ) -> FloatArray:
        """The poses (H, 4, 4) of a query in the map with most votes of their quads, at most ``count``, best first.

        Args:
            positions: (N, 3) m of the query, z up.
            labels: (N,) classes, numbered as in the map.
            map_positions: (M, 3) m.
            sigma_m: of a coordinate of an object, of query and map together.
            count: how many poses are wanted.
            is_excluded: which objects (K,) of the map, by their rows, make no match.
        """
        if len(positions) < 4:
            return np.zeros((0, 4, 4))
        matches = self._match(positions, labels, map_positions, sigma_m=sigma_m)
        if is_excluded is not None:
            kept = ~is_excluded(matches.reference[:, 0])
            matches = Matches(matches.query[kept], matches.reference[kept])
        rows, corners = np.unique(matches.reference, return_inverse=True)
        return vote_for_poses(
            positions,
            map_positions[rows].astype(np.float64),
            Matches(matches.query, corners.reshape(-1, 4)),
            tolerance_m=TOLERANCE_SIGMAS * sigma_m,
            count=count,
        )

    def _match(self, positions: FloatArray, labels: IntArray, map_positions: FloatArray, *, sigma_m: float) -> Matches:
        """Quads of the map like those of a query."""
        plane = positions[:, 0] + 1j * positions[:, 1]
        tolerance_m = min(TOLERANCE_SIGMAS * sigma_m, 0.5 * (MAX_CELLS - 1) * self.cell_m)
        sets = np.unique(neighbour_sets(positions[:, :2], np.arange(len(positions)), cKDTree(positions[:, :2])), axis=0)
        quads = possible_quads(plane, sets, tolerance_m)
        quad, entry = self._candidates(quads.lengths, labels[quads.vertices], tolerance_m)
        reference = np.minimum(np.take(self.vertices, entry, axis=0), len(map_positions) - 1)
        # Most differ in their base already: the other corners, all over the map, are not looked up.
        bases = np.abs(_corners(map_positions, reference[:, 1]) - _corners(map_positions, reference[:, 0]))
        alike = np.flatnonzero(np.abs(bases - quads.lengths[quad, 0]) <= tolerance_m)
        quad, reference = quad[alike], reference[alike].astype(np.int64)
        fits = _differences(_corners(map_positions, reference), quads.lengths[quad]) <= tolerance_m
        return Matches(quads.vertices[quad[fits]], reference[fits])

    def _candidates(self, lengths: FloatArray, labels: IntArray, tolerance_m: float) -> tuple[IntArray, IntArray]:
        """Pairs (C,) of a quad of the query and one of the map in its cells, at most ``BUDGET`` of them."""
        lowest = np.floor((lengths - tolerance_m) / self.cell_m).astype(np.int64)
        extents = np.floor((lengths + tolerance_m) / self.cell_m).astype(np.int64) - lowest
        steps = np.indices((int(extents.max(initial=0)) + 1,) * 5).reshape(5, -1).T
        row, step = np.nonzero(_are_within(steps, extents))
        # Keys add up along the lengths: of a quad's lowest cell, and of the step from there.
        keys = (lowest.astype(np.uint64) @ _PRIMES[:5])[row] + (steps.astype(np.uint64) @ _PRIMES[:5])[step]
        bucket = _hashed(keys ^ (labels.astype(np.uint64) @ _PRIMES[5:])[row], len(self.starts) - 1)
        first = self.starts[bucket].astype(np.int64)
        counts = np.maximum(np.minimum(self.starts[bucket + 1], len(self)).astype(np.int64) - first, 0)
        totals = np.bincount(row, weights=counts, minlength=len(lengths))
        order = np.argsort(totals, kind="stable")
        is_chosen = np.zeros(len(lengths), dtype=bool)
        is_chosen[order[: np.searchsorted(np.cumsum(totals[order]), BUDGET, side="right")]] = True
        used = is_chosen[row]
        row, first, counts = row[used], first[used], counts[used]
        begins = np.cumsum(counts) - counts
        entries = np.arange(int(counts.sum())) + np.repeat(first - begins, counts)
        return np.repeat(row, counts), entries


def build_quad_index(positions: FloatArray, labels: IntArray, *, sigma_m: float) -> QuadIndex:
    """The index of a map.

    Args:
        positions: (M, 3) m, z up.
        labels: (M,) classes.
        sigma_m: of a coordinate of an object.
    """
    tree = cKDTree(positions[:, :2])
    plane = positions[:, 0] + 1j * positions[:, 1]
    spacing_m = np.median(np.asarray(tree.query(positions[:, :2], k=2)[0])[:, 1]) if len(positions) > 1 else 1.0
    cell_m = max(CELL_SPACINGS * float(spacing_m), CELL_SIGMAS * sigma_m)
    buckets = 2 ** max(int(np.ceil(np.log2(8.0 * len(positions)))), 4)
    keys, vertices = list[NDArray[np.uint64]](), list[NDArray[np.uint32]]()
    for start in range(0, len(positions), CHUNK):
        centres = np.arange(start, min(start + CHUNK, len(positions)))
        quads = canonical_quads(plane, neighbour_sets(positions[:, :2], centres, tree))
        cells = np.floor(quads.lengths / cell_m).astype(np.int64)
        bucket = _buckets(cells, labels[quads.vertices], buckets).astype(np.uint64)
        identity = (np.sort(quads.vertices, axis=1).astype(np.uint64) * _PRIMES[:4]).sum(axis=1, dtype=np.uint64)
        keys.append((bucket << np.uint64(32)) | (identity >> np.uint64(32)))
        vertices.append(quads.vertices.astype(np.uint32))
    key, corners = np.concatenate(keys), np.concatenate(vertices)
    order = np.argsort(key, kind="stable")
    key = key[order]
    is_new = np.append(True, key[1:] != key[:-1]) if len(key) else np.zeros(0, dtype=bool)
    of_bucket = np.bincount((key[is_new] >> np.uint64(32)).astype(np.int64), minlength=buckets)
    starts = np.append(0, np.cumsum(of_bucket)).astype(np.uint32)
    return QuadIndex(corners[order[is_new]], starts, cell_m)


def _are_within(steps: IntArray, extents: IntArray) -> NDArray[np.bool_]:
    """Which of ``steps`` (S, 5) are within the ``extents`` (Q, 5) along each length: (Q, S)."""
    within = np.ones((len(extents), len(steps)), dtype=np.bool_)
    for along, most in zip(steps.T, extents.T, strict=True):
        within &= along <= most[:, None]
    return within


def _buckets(cells: IntArray, labels: IntArray, count: int) -> IntArray:
    """Bucket (Q,), of ``count``, of quads with the lengths' ``cells`` (Q, 5) and the corners' ``labels`` (Q, 4)."""
    return _hashed((cells.astype(np.uint64) @ _PRIMES[:5]) ^ (labels.astype(np.uint64) @ _PRIMES[5:]), count)


def _hashed(keys: NDArray[np.uint64], count: int) -> IntArray:
    """Bucket (Q,), of ``count``, of keys (Q,)."""
    mixed = keys ^ (keys >> np.uint64(29))
    mixed *= np.uint64(0xBF58476D1CE4E5B9)
    return np.asarray((mixed >> np.uint64(20)) & np.uint64(count - 1), dtype=np.int64)


def _corners(map_positions: FloatArray, rows: NDArray[np.integer]) -> NDArray[np.complex128]:
    """Positions (...) m, in the plane, of objects (...) of a map."""
    found = np.take(map_positions, rows, axis=0)
    return np.asarray(found[..., 0] + 1j * found[..., 1].astype(np.float64))


def _differences(corners: NDArray[np.complex128], lengths: FloatArray) -> FloatArray:
    """Largest difference (C,) of the lengths of quads with ``corners`` (C, 4) from ``lengths`` (C, 5)."""
    base = corners[:, 1] - corners[:, 0]
    length = np.abs(base)
    turn = (base / np.maximum(length, 1e-9)).conj()
    c, d = (corners[:, 2] - corners[:, 0]) * turn, (corners[:, 3] - corners[:, 0]) * turn
    own = np.column_stack([length, c.real, c.imag, d.real, d.imag])
    return np.asarray(np.abs(own - lengths).max(axis=1, initial=0.0))
