"""A descriptor without information: the lower bound of a comparison."""

import numpy as np

from descriptors.arrays import Float32Array
from descriptors.constellation import Constellations


class RandomVector:
    """Random numbers, the same ones for the same calls in the same order."""

    name = "random"
    radius_m = 30.0
    length = 16

    def __init__(self) -> None:
        self._rng = np.random.default_rng(0)

    def describe(self, constellations: Constellations) -> Float32Array:
        """Vectors (B, length) that do not depend on the constellations."""
        return self._rng.normal(size=(len(constellations), self.length)).astype(np.float32)
