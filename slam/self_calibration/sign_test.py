"""Whether what blocks of a log gain is more than chance: the sign-flip test."""

from __future__ import annotations

from itertools import product

import numpy as np

from slam.common.arrays import FloatArray

BLOCKS = 14
"""Stretches of the log whose gains are independent."""
CHANCE = 0.01
"""Probability by which chance, which gives each block's gain either sign, may gain as much."""
_SIGNS = np.array(list(product((1.0, -1.0), repeat=BLOCKS)))


def is_beyond_chance(gains: FloatArray) -> bool:
    """Whether the sum of the gains (BLOCKS,) is more than chance."""
    return bool(np.mean(_SIGNS @ gains >= gains.sum() * (1.0 - 1e-12)) <= CHANCE)
