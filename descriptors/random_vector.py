"""A descriptor without information: the lower bound of a comparison."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from descriptors.constellation import Constellations


class RandomVector:
    """Random numbers, the same ones for the same calls in the same order."""

    name = "random"

    def __init__(self, radius_m: float = 30.0, length: int = 16) -> None:
        self.radius_m = radius_m
        self.length = length
        self._rng = np.random.default_rng(0)

    def describe(self, constellations: Constellations) -> NDArray[np.float32]:
        """Vectors (B, length) that do not depend on the constellations."""
        return self._rng.normal(size=(len(constellations), self.length)).astype(np.float32)
