"""The learned likelihood ratio by numpy alone, so that a replay needs no torch."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from descriptors.arrays import BoolArray, Float32Array, FloatArray
from descriptors.descriptellation_lr.pairs import (
    DENSITY,
    FEATURES,
    MAX_NEIGHBOURS,
    MAX_SIGMA,
    MIN_RADIUS,
    QUERY_FEATURES,
    DescriptellationLRArchitecture,
    Pairs,
    query_features,
)
from descriptors.errors import WeightsError
from descriptors.learned.weights import make_architecture, read_weights

RADIUS_STEPS = 1024
"""Resolution of the table of kernels in distance: a tenth of the width of a kernel."""
SIGMA_STEPS, TURN_STEPS = 64, 16
"""Resolution of the table of kernels: widths across the direction of a neighbour, and directions within a sector."""


class LearnedLikelihood:
    """Which cells around a pair of the map are likely to hold an object, and what an observed object tells there."""

    name = "descriptellation_lr"

    def __init__(self, path: Path) -> None:
        """Load a file of weights.

        Raises:
            WeightsError: it is missing, damaged, or none of a learned likelihood.
        """
        self._weights, self.architecture = _load(path)
        sizes = self.architecture
        along, self._across, self._heading = np.exp(self._weights["log_widths"])
        edges = sizes.edges
        radii = np.linspace(0.0, sizes.outer, RADIUS_STEPS)
        self._rings = np.diff(ndtr((edges - radii[:, None]) / along), axis=1).astype(np.float32)  # (steps, R)
        self._sigmas = np.geomspace(0.01, MAX_SIGMA, SIGMA_STEPS)
        # Share of a neighbour in each sector by its width and its direction in the first sector: (sigmas, turns, S).
        step = 2.0 * np.pi / sizes.sectors
        turns = (np.arange(TURN_STEPS) + 0.5) / TURN_STEPS * step
        apart = (np.arange(sizes.sectors) * step - turns[:, None] + np.pi) % (2.0 * np.pi) - np.pi
        wide = self._sigmas[:, None, None]
        self._sectors = (ndtr((apart + step) / wide) - ndtr(apart / wide)).astype(np.float32)
        area = np.diff(edges**2) * (np.pi / sizes.sectors)
        self._least = (np.expm1(self._weights["threshold"]) * DENSITY * area).astype(np.float32)

    def bits(self, pairs: Pairs) -> BoolArray:
        """Which cells (P, cells) around pairs of a map are likely to hold an object."""
        sizes = self.architecture
        present = np.arange(MAX_NEIGHBOURS + 2) < pairs.counts[:, None]
        rings, sectors = (np.zeros((*present.shape, count), np.float32) for count in (sizes.rings, sizes.sectors))
        gates = np.exp(self._perceive("gate", pairs.features))
        steps = np.rint(pairs.radii * ((RADIUS_STEPS - 1) / sizes.outer)).astype(np.int64)
        rings[present] = gates * self._rings[np.minimum(steps, RADIUS_STEPS - 1)]
        sigmas = np.hypot(
            self._across / np.maximum(pairs.radii, MIN_RADIUS), self._heading / pairs.lengths[pairs.owners]
        )
        ratio = np.log(self._sigmas[-1] / self._sigmas[0]) / (SIGMA_STEPS - 1)
        wide = np.clip(np.rint(np.log(sigmas / self._sigmas[0]) / ratio), 0, SIGMA_STEPS - 1).astype(np.int64)
        turns = (pairs.angles / (2.0 * np.pi) % 1.0) * sizes.sectors
        sector = np.floor(turns).astype(np.int64)
        fine = np.minimum(((turns - sector) * TURN_STEPS).astype(np.int64), TURN_STEPS - 1)
        columns = (np.arange(sizes.sectors) - sector[:, None]) % sizes.sectors
        first = (wide * TURN_STEPS + fine) * sizes.sectors
        sectors[present] = np.take(self._sectors, first[:, None] + columns)
        mass = rings.transpose(0, 2, 1) @ sectors  # (P, R, S)
        return (mass > self._least[:, None]).reshape(len(pairs), -1)

    def worths(self, pairs: Pairs, sigmas: FloatArray) -> tuple[Float32Array, Float32Array]:
        """Nats (K,) that an observed neighbour gives where the bit of its cell is set, and takes where it is not.

        ``sigmas`` (P,) spacings, as :func:`query_features` has them.
        """
        hits, misses = np.logaddexp(0.0, self._perceive("worth", query_features(pairs, sigmas))).T
        return hits, misses

    def _perceive(self, name: str, features: Float32Array) -> Float32Array:
        hidden = np.tanh(features @ self._weights[f"{name}.0.weight"].T + self._weights[f"{name}.0.bias"])
        return hidden @ self._weights[f"{name}.2.weight"].T + self._weights[f"{name}.2.bias"]


def _load(path: Path) -> tuple[dict[str, NDArray[Any]], DescriptellationLRArchitecture]:
    """Tensors of a file, and the architecture that they fit."""
    weights = read_weights(path)
    architecture = make_architecture(path, DescriptellationLRArchitecture, weights.architecture)
    hidden = architecture.hidden
    shapes = {"log_widths": (3,), "threshold": (architecture.rings,), "gate.0.weight": (hidden, FEATURES),
              "gate.0.bias": (hidden,), "gate.2.weight": (1, hidden), "gate.2.bias": (1,),
              "worth.0.weight": (hidden, QUERY_FEATURES), "worth.0.bias": (hidden,), "worth.2.weight": (2, hidden),
              "worth.2.bias": (2,)}  # fmt: skip
    found = {name: tensor.shape for name, tensor in weights.tensors.items() if tensor.dtype == np.float32}
    wrong = sorted(name for name in {*weights.tensors, *shapes} if found.get(name) != shapes.get(name))
    if wrong:
        raise WeightsError(f"{path}: tensors that do not fit the architecture: {', '.join(wrong)}")
    if not all(np.isfinite(tensor).all() for tensor in weights.tensors.values()):
        raise WeightsError(f"{path}: a tensor is not finite; download it again")
    sizes = (architecture.rings, architecture.sectors, architecture.partners)
    if not (0.0 < architecture.inner < architecture.outer < np.inf and 0 < min(sizes) <= max(sizes) <= 512):
        raise WeightsError(f"{path}: its sizes are invalid: {architecture}")
    return dict(weights.tensors), architecture
