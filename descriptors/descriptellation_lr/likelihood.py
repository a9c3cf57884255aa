"""The learned likelihood by numpy alone, so that a replay needs no torch."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.special import erf, expit

from descriptors.constellation import Constellations
from descriptors.descriptellation_lr.rings import (
    FEATURES,
    FINE,
    Background,
    DescriptellationLRArchitecture,
    horizontal_m,
    neighbour_features,
    ring_features,
)
from descriptors.errors import WeightsError
from descriptors.learned.weights import make_architecture, read_weights

MAX_NATS = 6.0
"""Most of one neighbour: what a byte of the index holds above ``min_nats``, 8 nats from -2 on."""
NEAR = 0.25
"""Near neighbours are those within that share of the radius, which is half of the sensor's range: what is seen from one
place."""
MAX_RINGS = 10_000
"""Of a file of weights."""


class LearnedLikelihood:
    """A likelihood of neighbours by class and distance, its kernels and gates as they were trained.

    The background is that of the objects that were described so far, so one of these belongs to one map.
    """

    name = "descriptellation_lr"
    min_nats = -2.0

    def __init__(self, path: Path) -> None:
        """Load a file of weights.

        Raises:
            WeightsError: it is missing, damaged, or none of a learned likelihood.
        """
        self._weights, architecture = _load(path)
        self._rings = architecture.rings
        self.radius_m = self._rings.radius_m
        self.near_m = NEAR * self.radius_m
        self.rings = len(self._rings)
        self._background = Background(self._rings)
        self._kernels = self._make_kernels()

    def describe(self, constellations: Constellations) -> NDArray[np.float32]:
        """Vectors (B, C * rings) in nats: for each class of the vocabulary the rings from the inside out."""
        self._background.add(constellations)
        size = len(constellations.vocabulary)
        background = self._background.density(size)
        gates = np.exp(self._perceive("gate", neighbour_features(constellations)))
        fine = self._rings.fine(horizontal_m(constellations.positions))
        # Most objects have neighbours of a few classes only: the rows of the others stay 0.
        there, rows = np.unique(constellations.owners * size + constellations.labels, return_inverse=True)
        density, level = self._laid(gates, rows, fine, len(there))
        classes = there % size if size else there
        per_background = (1.0 / background).astype(np.float32)[classes]
        worth, crowded = self._ring_terms(background)
        nats = np.zeros((len(constellations) * size, self.rings), dtype=np.float32)
        nats[there] = worth[classes] * (
            np.log1p(density * per_background) - crowded[classes] * np.log1p(level * per_background)
        )
        return nats.reshape(len(constellations), size * self.rings)

    def cells(self, constellations: Constellations) -> NDArray[np.int64]:
        """Which entry (P,) of a vector each neighbour falls into, where it is observed."""
        return constellations.labels * self.rings + self._rings.of(horizontal_m(constellations.positions))

    def max_nats(self, constellations: Constellations) -> NDArray[np.float32]:
        """The most that a query (B,) could score, if each neighbour were as telling as a vector can hold."""
        return (MAX_NATS * np.diff(constellations.offsets)).astype(np.float32)

    def _make_kernels(self) -> NDArray[np.float32]:
        edges_m, middle_m = self._rings.edges_m, self._rings.fine_m
        widths = np.exp(self._weights["log_width"])[:, None]
        sigma = np.hypot(widths, np.exp(self._weights["log_growth"])[:, None] * middle_m)
        below = 0.5 * erf((edges_m - middle_m[:, None]) / (np.sqrt(2.0) * sigma[:, :, None]))
        return np.asarray(np.diff(below, axis=2) / np.diff(edges_m), dtype=np.float32)

    def _laid(
        self, gates: NDArray[np.float32], rows: NDArray[np.int64], fine: NDArray[np.int64], count: int
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Density and level, (count, R) each: sums by row of the kernels at the distances of neighbours (P,), weighted
        by their gates (P, W), and of the wide kernel, weighted by the sums of the gates.
        """
        weights = np.column_stack([gates, gates.sum(axis=1)])
        kernels = np.arange(len(self._kernels))
        below = rows[:, None] + count * kernels  # one product for all kernels, which lie below each other
        columns = fine[:, None] + FINE * kernels
        shape = count * len(kernels), FINE * len(kernels)
        laid = csr_matrix((weights.ravel(), (below.ravel(), columns.ravel())), shape=shape)
        sums = (laid @ self._kernels.reshape(-1, self.rings)).reshape(len(kernels), count, self.rings)
        return sums[:-1].sum(axis=0), sums[-1]

    def _ring_terms(self, background: NDArray[np.float64]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        features = ring_features(background, self._rings).reshape(-1, 2).astype(np.float32)
        terms = self._perceive("ring", features).reshape(*background.shape, 2)
        return np.exp(terms[:, :, 0]), np.asarray(expit(terms[:, :, 1]))

    def _perceive(self, name: str, features: NDArray[np.float32]) -> NDArray[np.float32]:
        hidden = np.tanh(features @ self._weights[f"{name}.0.weight"].T + self._weights[f"{name}.0.bias"])
        return np.asarray(hidden @ self._weights[f"{name}.2.weight"].T + self._weights[f"{name}.2.bias"])


def _load(path: Path) -> tuple[dict[str, NDArray[Any]], DescriptellationLRArchitecture]:
    """Tensors of a file, and the architecture that they fit."""
    weights = read_weights(path)
    architecture = make_architecture(path, DescriptellationLRArchitecture, weights.architecture)
    hidden, of_rings, kernels = architecture.hidden, architecture.ring_hidden, len(architecture.widths_m)
    shapes = {"gate.0.weight": (hidden, FEATURES), "gate.0.bias": (hidden,), "gate.2.weight": (kernels, hidden),
              "gate.2.bias": (kernels,), "log_width": (kernels + 1,), "log_growth": (kernels + 1,),
              "ring.0.weight": (of_rings, 2), "ring.0.bias": (of_rings,), "ring.2.weight": (2, of_rings),
              "ring.2.bias": (2,)}  # fmt: skip
    found = {name: tensor.shape for name, tensor in weights.tensors.items() if tensor.dtype == np.float32}
    wrong = sorted(name for name in {*weights.tensors, *shapes} if found.get(name) != shapes.get(name))
    if wrong:
        raise WeightsError(f"{path}: tensors that do not fit the architecture: {', '.join(wrong)}")
    if not all(np.isfinite(tensor).all() for tensor in weights.tensors.values()):
        raise WeightsError(f"{path}: a tensor is not finite; get it again")
    least_m = architecture.radius_m / MAX_RINGS
    if not 0.0 < least_m <= architecture.least_ring_m < np.inf or not 0.0 <= architecture.ring_growth < np.inf:
        raise WeightsError(f"{path}: its rings are invalid: {architecture}")
    return dict(weights.tensors), architecture
