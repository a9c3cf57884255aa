"""The learned likelihood as a network of torch, for training; ``likelihood`` evaluates it by numpy."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from descriptors.constellation import Constellations
from descriptors.descriptellation_lr.rings import (
    FEATURES,
    Background,
    DescriptellationLRArchitecture,
    Rings,
    horizontal_m,
    neighbour_features,
    ring_features,
)


class DescriptellationLR(nn.Module):
    """``worth * (log(1 + sum_n sum_w gate_nw K_w(r, d_n) / background) - crowded * log(1 + level))`` for each ring r.

    Each neighbour n of an object lays kernels of several widths over the rings; how much each counts, a small network
    decides from what is around (attention over the neighbours). The level is the same sum with one wide kernel: among
    many neighbours, the presence of one carries no information; only its exact position does.
    """

    def __init__(self, architecture: DescriptellationLRArchitecture | None = None) -> None:
        super().__init__()
        self.architecture = architecture or DescriptellationLRArchitecture()
        sizes = self.architecture
        self.rings = sizes.rings
        kernels = len(sizes.widths_m)
        self.log_width = nn.Parameter(torch.log(torch.tensor([*sizes.widths_m, sizes.level_width_m])))
        self.log_growth = nn.Parameter(torch.log(torch.tensor([*sizes.widths_per_m, sizes.level_width_per_m])))
        self.gate = _perceptron(FEATURES, sizes.hidden, kernels, start=float(np.log(sizes.odds)))
        self.ring = _perceptron(2, sizes.ring_hidden, 2, start=0.0)

    def kernels(self) -> Tensor:
        """Densities (W + 1, FINE, R) per metre: mean over each ring of a normal density at each distance."""
        edges = torch.tensor(self.rings.edges_m, dtype=torch.float32)
        middle = torch.tensor(self.rings.fine_m, dtype=torch.float32)
        sigma = torch.hypot(self.log_width.exp()[:, None], self.log_growth.exp()[:, None] * middle)  # (W + 1, FINE)
        scaled = (edges - middle[:, None]) / (np.sqrt(2.0) * sigma[:, :, None])  # (W + 1, FINE, R + 1)
        below = 0.5 * torch.erf(scaled)
        return (below[:, :, 1:] - below[:, :, :-1]) / (edges[1:] - edges[:-1])

    def forward(self, constellations: Constellations, background: NDArray[np.float64]) -> Tensor:
        """Nats (B, C, R) of each object of a map for a neighbour of each class in each ring."""
        size, rings = background.shape
        gates = self.gate(torch.as_tensor(neighbour_features(constellations))).exp()  # (P, W)
        fine = torch.as_tensor(self.rings.fine(horizontal_m(constellations.positions)))
        rows = torch.as_tensor(constellations.owners * size + constellations.labels)
        empty = torch.zeros(len(constellations) * size, rings)
        *kernels, wide = self.kernels()
        density, level = empty, empty.index_add(0, rows, gates.sum(dim=1, keepdim=True) * wide.index_select(0, fine))
        for gate, kernel in zip(gates.unbind(1), kernels, strict=True):
            density = density.index_add(0, rows, gate[:, None] * kernel.index_select(0, fine))
        per_background = 1.0 / torch.as_tensor(background, dtype=torch.float32)
        worth, crowded = self.ring_terms(background)
        there = torch.log1p(density.view(-1, size, rings) * per_background)
        return worth * (there - crowded * torch.log1p(level.view(-1, size, rings) * per_background))

    def ring_terms(self, background: NDArray[np.float64]) -> tuple[Tensor, Tensor]:
        """For each class and ring (C, R), the weight of an observed neighbour there, 1 if it were independent of all
        others, and how much of the level is taken off, 0 to 1.
        """
        terms = self.ring(torch.as_tensor(ring_features(background, self.rings), dtype=torch.float32))
        return terms[:, :, 0].exp(), terms[:, :, 1].sigmoid()


def _perceptron(inputs: int, hidden: int, outputs: int, *, start: float) -> nn.Sequential:
    """Two layers that give ``start`` for everything until they are trained."""
    first, last = nn.Linear(inputs, hidden), nn.Linear(hidden, outputs)
    nn.init.zeros_(last.weight)
    nn.init.constant_(last.bias, start)
    return nn.Sequential(first, nn.Tanh(), last)


def query_scores(nats: Tensor, queries: Constellations, rings: Rings) -> Tensor:
    """The inner products (Q, B) of queries, which are one-hot in classes and rings, with the map's vectors."""
    cells = queries.labels * len(rings) + rings.of(horizontal_m(queries.positions))
    flat = nats.flatten(1).T  # (C R, B)
    picked = flat.index_select(0, torch.as_tensor(cells))
    return flat.new_zeros(len(queries), flat.shape[1]).index_add(0, torch.as_tensor(queries.owners), picked)


def background_of(constellations: Constellations, rings: Rings) -> NDArray[np.float64]:
    """The background of a map that consists of these objects."""
    background = Background(rings)
    background.add(constellations)
    return background.density(len(constellations.vocabulary))
