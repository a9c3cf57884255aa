"""The learned likelihood at work: the map tower by numpy alone, so that a replay needs no torch."""

from __future__ import annotations

import json
from collections.abc import Mapping
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
    Rings,
    horizontal_m,
    neighbour_features,
    ring_features,
)
from descriptors.errors import WeightsError

FORMAT = "descriptellation towers 1"
MOST_NATS = 6.0
"""Most of one neighbour: what a byte of the index holds above ``least_nats``, 8 nats from -2 on."""
NEAR = 0.25
"""Near neighbours are those within that share of the radius, which is half of the sensor's range: what is seen from one
place."""
MOST_RINGS = 10_000
"""What a file of weights may ask for."""


class LearnedLikelihood:
    """A likelihood of neighbours by class and distance, its kernels and gates as they were trained.

    The background is that of the objects that were described so far, so one of these belongs to one map.
    """

    name = "descriptellation_lr"
    least_nats = -2.0

    def __init__(self, path: Path) -> None:
        """Load a file of weights.

        Raises:
            WeightsError: it is missing, damaged, or none of a learned likelihood.
        """
        self._weights, self.metadata = read_towers(path)
        architecture = self.metadata["architecture"]
        self._rings = Rings(architecture["radius_m"], architecture["least_ring_m"], architecture["ring_growth"])
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

    def most_nats(self, constellations: Constellations) -> NDArray[np.float32]:
        """The most that a query (B,) could score, if each neighbour were as telling as a vector can hold."""
        return (MOST_NATS * np.diff(constellations.offsets)).astype(np.float32)

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


def is_learned_likelihood(path: Path) -> bool:
    """Whether a file is one of weights of a learned likelihood; a damaged one is not."""
    from safetensors import SafetensorError, safe_open

    try:
        with safe_open(path, framework="np") as file:
            return (file.metadata() or {}).get("format") == FORMAT
    except (SafetensorError, OSError):
        return False


def read_towers(path: Path) -> tuple[dict[str, NDArray[np.float32]], dict[str, Any]]:
    """Tensors and metadata of a file of weights.

    Raises:
        WeightsError: it is missing, damaged, or none of a learned likelihood.
    """
    from safetensors import SafetensorError, safe_open

    if not path.is_file():
        raise WeightsError(f"{path}: no such file")
    try:
        with safe_open(path, framework="np") as file:
            texts = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError) as error:
        raise WeightsError(f"{path}: truncated, or no safetensors file: {error}; get it again") from error
    if texts.get("format") != FORMAT:
        raise WeightsError(f"{path}: no weights of a learned likelihood; its format is {texts.get('format')!r}")
    try:
        metadata = {key: json.loads(value) for key, value in texts.items() if key != "format"}
        is_sound = _fit(tensors, metadata["architecture"])
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise WeightsError(
            f"{path}: its metadata are damaged ({type(error).__name__}: {error}); get it again"
        ) from error
    if not is_sound:
        raise WeightsError(f"{path}: its tensors or rings are not those of its architecture; get it again")
    return tensors, metadata


def _fit(tensors: Mapping[str, NDArray[np.float32]], architecture: Mapping[str, Any]) -> bool:
    """Whether tensors are all there, of the right shapes, finite, and rings not without number."""
    hidden, kernels = architecture["hidden"], len(architecture["widths_m"])
    of_rings = len(tensors["ring.0.bias"])
    shapes = {"gate.0.weight": (hidden, FEATURES), "gate.0.bias": (hidden,), "gate.2.weight": (kernels, hidden),
              "gate.2.bias": (kernels,), "log_width": (kernels + 1,), "log_growth": (kernels + 1,),
              "ring.0.weight": (of_rings, 2), "ring.0.bias": (of_rings,), "ring.2.weight": (2, of_rings),
              "ring.2.bias": (2,)}  # fmt: skip
    radius_m, least_m, growth = (float(architecture[key]) for key in ("radius_m", "least_ring_m", "ring_growth"))
    return (
        {name: tensor.shape for name, tensor in tensors.items()} == shapes
        and all(np.isfinite(tensor).all() for tensor in tensors.values())
        and 0.0 < radius_m < np.inf
        and 0.0 <= growth < np.inf
        and radius_m / MOST_RINGS <= least_m < np.inf
    )
