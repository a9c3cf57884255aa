"""X-View's random walks: which classes are met on short walks over the graph of a constellation.

Gawel et al., X-View: Graph-Based Semantic Multi-View Localization, RA-L 2018, as a baseline of the Descriptellation
paper (Section IV-C): 30 walks over 4 objects, the described one included. X-View counts the walks that two objects have
in common; here each sequence of classes has a fixed random vector and a descriptor is their sum, so that nearness of
vectors means the same.
"""

from __future__ import annotations

import hashlib

import numpy as np
from numpy.typing import NDArray

from descriptors.constellation import Constellations
from descriptors.learned.padded import PaddedConstellations, pad_constellations

CHUNK = 256
"""Constellations that are walked over at a time, which bounds the memory."""


class RandomWalk:
    """``walks`` of ``steps`` objects each; edges join objects nearer than the mean distance in their constellation.

    A walk does not step back at once unless there is no other way. It draws by the rank of the neighbours, nearest
    first, from numbers that are the same for all constellations: equal ones have equal walks, in whatever order their
    objects are listed.
    """

    name = "random_walk"

    def __init__(self, radius_m: float = 30.0, walks: int = 30, steps: int = 4, length: int = 512) -> None:
        self.radius_m = radius_m
        self._length = length
        self._draws = np.random.default_rng(0).random((steps - 1, walks))

    def describe(self, constellations: Constellations) -> NDArray[np.float32]:
        """Vectors (B, length)."""
        codes = _class_codes(constellations.vocabulary)
        described = np.zeros((len(constellations), self._length), dtype=np.float32)
        for start in range(0, len(constellations), CHUNK):
            rows = np.arange(start, min(start + CHUNK, len(constellations)))
            padded = _sorted_by_distance(pad_constellations(constellations[rows]), codes)
            visited = walk(neighbours_of(padded), self._draws)  # (b, walks, steps)
            labels = padded.labels[np.arange(len(rows))[:, None, None], visited]
            columns, signs = self._hashed(codes[labels])
            np.add.at(described, (rows[:, None], columns), signs)
        return described

    def _hashed(self, codes: NDArray[np.uint64]) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """Column and sign, each (b, walks), of the sequences of class codes (b, walks, steps): feature hashing."""
        mixed = np.zeros(codes.shape[:-1], dtype=np.uint64)
        for step in range(codes.shape[-1]):
            mixed = (mixed ^ codes[..., step]) * np.uint64(0x9E3779B97F4A7C15)
            mixed ^= mixed >> np.uint64(29)
        columns = (mixed >> np.uint64(1)) % np.uint64(self._length)
        return columns.astype(np.int64), np.where(mixed & np.uint64(1), 1.0, -1.0).astype(np.float32)


def neighbours_of(constellations: PaddedConstellations) -> NDArray[np.bool_]:
    """Which objects are joined (B, N, N): two present ones no farther apart than the mean of their constellation."""
    plane = constellations.positions[..., 0] + 1j * constellations.positions[..., 1]
    apart_m = np.abs(plane[:, :, None] - plane[:, None, :])
    both = constellations.present[:, :, None] & constellations.present[:, None, :]
    counts = constellations.present.sum(axis=1)
    mean_m = np.where(both, apart_m, 0.0).sum(axis=(1, 2)) / np.maximum(counts * (counts - 1), 1)
    itself = np.eye(both.shape[1], dtype=bool)
    return np.asarray(both & ~itself & (apart_m <= mean_m[:, None, None] * (1.0 + 1e-5)))


def walk(joined: NDArray[np.bool_], draws: NDArray[np.float64]) -> NDArray[np.int64]:
    """Objects visited (B, walks, steps) from the first one on, over a graph (B, N, N).

    Args:
        joined: the graph.
        draws: (steps - 1, walks) uniform in [0, 1): which of the ways open is taken.
    """
    batch = np.arange(len(joined))[:, None]
    here = np.zeros((len(joined), draws.shape[1]), dtype=np.int64)
    before = here
    visited = [here]
    for draw in draws:
        ways = joined[batch, here]  # (B, walks, N)
        back = np.arange(joined.shape[1]) == before[..., None]
        onward = ways & ~back
        ways = np.where(onward.any(axis=2, keepdims=True), onward, ways)
        chosen = np.floor(draw * ways.sum(axis=2)).astype(np.int64)
        reached = np.argmax(np.cumsum(ways, axis=2) > chosen[..., None], axis=2)
        before, here = here, np.where(ways.any(axis=2), reached, here)
        visited.append(here)
    return np.stack(visited, axis=2)


def _sorted_by_distance(constellations: PaddedConstellations, codes: NDArray[np.uint64]) -> PaddedConstellations:
    """The centre first, then the others by distance, by the name of their class where that is equal to a millimetre."""
    distances_m = np.hypot(constellations.positions[..., 0], constellations.positions[..., 1])
    # Rounded, or a turned copy would be listed in another order; of one class, the order of the list must not decide.
    keys = np.where(constellations.present, np.round(distances_m, 3), np.inf)
    keys[:, 0] = -1.0
    order = np.lexsort((distances_m, codes[constellations.labels], keys), axis=1)
    batch = np.arange(len(keys))[:, None]
    return PaddedConstellations(
        constellations.positions[batch, order],
        constellations.labels[batch, order],
        constellations.present[batch, order],
    )


def _class_codes(vocabulary: tuple[str, ...]) -> NDArray[np.uint64]:
    """Numbers (C,) that depend on the names alone."""
    digests = [hashlib.sha256(name.encode()).digest()[:8] for name in vocabulary]
    return np.array([int.from_bytes(digest, "little") for digest in digests], dtype=np.uint64)
