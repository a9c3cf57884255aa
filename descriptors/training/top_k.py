"""How often descriptors of one thing are among each other's nearest."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

CHUNK = 1000


def top_k_ratio(vectors: NDArray[np.float32], things: NDArray[np.int64], k: int) -> float:
    """Share of vectors (B, D) with one of the same thing (B,) among the ``k`` nearest of all others.

    The paper's measure of a training (Descriptellation, Section III-F). NaN for fewer than two vectors.
    """
    if len(vectors) < 2:
        return float("nan")
    k = min(k, len(vectors) - 1)
    squares = np.einsum("ij,ij->i", vectors, vectors)
    hits = 0
    for start in range(0, len(vectors), CHUNK):
        rows = np.arange(start, min(start + CHUNK, len(vectors)))
        squared = squares - 2.0 * (vectors[rows] @ vectors.T)
        squared[rows - start, rows] = np.inf
        nearest = np.argpartition(squared, k - 1, axis=1)[:, :k]
        hits += int((things[nearest] == things[rows, None]).any(axis=1).sum())
    return hits / len(vectors)
