"""Soft histogram of classes over rings around an object: the handcrafted descriptor that loop closing uses.

An onion histogram (see ``baselines``) with three changes. A neighbour counts in all rings by a Gaussian of its
distance, so that noise moves a vector a little where it would move a hard count by one. Classes enter as fixed random
vectors, so that the length does not grow with the vocabulary. Far rings weigh less, being the first to be incomplete.
It turns with nothing and does not depend on the order of the objects.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from descriptors.class_vectors import class_vectors
from descriptors.constellation import Constellations


class RingHistogram:
    """``rings`` of equal width out to ``radius_m``, softened by ``sigma_m``; ``class_length`` numbers a ring."""

    name = "ring_histogram"

    def __init__(
        self, radius_m: float = 40.0, rings: int = 16, sigma_m: float = 1.2, class_length: int = 16, fade_m: float = 5.0
    ) -> None:
        self.radius_m = radius_m
        self._sigma_m = sigma_m
        self._class_length = class_length
        self._middles_m = (np.arange(rings) + 0.5) * radius_m / rings
        self._weights = 1.0 / np.sqrt(1.0 + self._middles_m / fade_m)

    @property
    def length(self) -> int:
        """How many numbers a vector has."""
        return len(self._middles_m) * self._class_length

    def describe(self, constellations: Constellations) -> NDArray[np.float32]:
        """Vectors (B, length): for each class vector's coordinate the rings from the inside out."""
        distances = np.hypot(constellations.positions[:, 0], constellations.positions[:, 1])
        softness = (distances[:, None] - self._middles_m) / self._sigma_m
        memberships = np.exp(-0.5 * softness**2) * self._weights  # (P, rings)
        classes = len(constellations.vocabulary)
        cells = constellations.owners * classes + constellations.labels
        count = len(cells)
        gather = sparse.csr_array(
            (np.ones(count), (cells, np.arange(count))), shape=(len(constellations) * classes, count)
        )
        histogram = np.asarray(gather @ memberships).reshape(len(constellations), classes, len(self._middles_m))
        vectors = class_vectors(constellations.vocabulary, self._class_length)
        described = np.einsum("bcr,cv->bvr", histogram, vectors, optimize=True)
        return np.asarray(described.reshape(len(constellations), self.length), dtype=np.float32)
