"""Scattered objects for the tests of descriptors."""

from __future__ import annotations

import numpy as np

from slam.geometry import FloatArray, IntArray

VOCABULARY = ("bench", "lamp", "sign", "tree")


def scattered(count: int, *, seed: int, side_m: float = 60.0) -> tuple[FloatArray, IntArray]:
    """Positions (N, 3) m in a square, and labels (N,)."""
    rng = np.random.default_rng(seed)
    positions = np.column_stack([rng.uniform(0.0, side_m, (count, 2)), rng.uniform(-1.0, 3.0, count)])
    return positions, rng.integers(len(VOCABULARY), size=count)
