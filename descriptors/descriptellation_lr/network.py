"""The likelihood ratio as a network of torch, for training; ``likelihood`` evaluates it by numpy."""

import numpy as np
import torch
from torch import Tensor, nn

from descriptors.arrays import Float32Array
from descriptors.descriptellation_lr.pairs import (
    DENSITY,
    FEATURES,
    MAX_SIGMA,
    MIN_RADIUS,
    QUERY_FEATURES,
    DescriptellationLRArchitecture,
    Pairs,
    cells_of,
)


class DescriptellationLR(nn.Module):
    """Two towers whose inner product is a log-likelihood ratio.

    The tower of the map sets a bit for each cell around a pair in which a neighbour is that much likelier than in an
    average place. Each neighbour of the map is blurred by a kernel, whose widths along and across its direction are
    learned; a gate, attention over the neighbours, decides how much it counts. The tower of the query gives each
    observed neighbour nats for a cell whose bit is set, and takes nats for one whose bit is not, by its distance, the
    length of the pair, the noise, and the number of neighbours.
    """

    def __init__(self, architecture: DescriptellationLRArchitecture) -> None:
        super().__init__()
        self.architecture = sizes = architecture
        # Widths of a kernel in spacings: along, across, and of the heading times the length of a pair.
        self.log_widths = nn.Parameter(torch.log(torch.tensor([0.05, 0.06, 0.07])))
        self.gate = _perceptron(FEATURES, sizes.hidden, 1)
        self.threshold = nn.Parameter(torch.full((sizes.rings,), 0.8))
        self.worth = _perceptron(QUERY_FEATURES, sizes.hidden, 2)

    def forward(self, pairs: Pairs) -> Tensor:
        """Logits (P, R, S) of the bits of pairs of the map: nats above the threshold."""
        sizes, device = self.architecture, self.threshold.device
        owners = torch.as_tensor(pairs.owners, device=device)
        gates = self.gate(torch.as_tensor(pairs.features, device=device)).exp()  # (K, 1)
        edges = torch.as_tensor(sizes.edges, dtype=torch.float32, device=device)
        radii, angles, lengths = (edges.new_tensor(each) for each in (pairs.radii, pairs.angles, pairs.lengths))
        along, across, heading = self.log_widths.exp().unbind()
        # What share of each neighbour falls into each ring, between the edges, and each sector. The width along its
        # direction is a constant; across it the noise of the neighbour itself adds to that of the heading of the pair,
        # which grows with the distance and falls with the length of the pair.
        rings = torch.special.ndtr((edges - radii[:, None]) / along).diff(dim=1)  # (K, R)
        sigma = torch.hypot(across / radii.clamp(min=MIN_RADIUS), heading / lengths[owners]).clamp(max=MAX_SIGMA)
        step = 2.0 * np.pi / sizes.sectors
        borders = torch.arange(sizes.sectors, device=device) * step
        apart = torch.remainder(borders - angles[:, None] + np.pi, 2.0 * np.pi) - np.pi  # (K, S) of the first border
        upper, lower = (torch.special.ndtr(border / sigma[:, None]) for border in (apart + step, apart))
        area = edges.square().diff() * (np.pi / sizes.sectors)  # (R,)
        laid = torch.einsum("kr,ks->krs", gates * rings, upper - lower)
        mass = torch.zeros(len(pairs), sizes.rings, sizes.sectors, device=device).index_add(0, owners, laid)
        return torch.log1p(mass / (DENSITY * area[:, None])) - self.threshold[:, None]

    def bits(self, logits: Tensor) -> Tensor:
        """Bits (P, R, S) with the gradient of a sigmoid, in which they change over half a nat."""
        soft = (logits / 0.5).sigmoid()
        return soft + ((logits > 0.0).float() - soft).detach()

    def worths(self, features: Float32Array) -> tuple[Tensor, Tensor]:
        """Nats (K,) that a neighbour gives where its bit is set, and that it takes where it is not."""
        nats = nn.functional.softplus(self.worth(torch.as_tensor(features, device=self.threshold.device)))
        return nats[:, 0], nats[:, 1]


def query_scores(
    bits: Tensor, queries: Pairs, hits: Tensor, misses: Tensor, architecture: DescriptellationLRArchitecture
) -> Tensor:
    """Log-likelihood ratios (Q, P) of pairs of a query being pairs of the map with these ``bits`` (P, R, S)."""
    cells = torch.as_tensor(cells_of(queries, architecture), device=bits.device)
    owners = torch.as_tensor(queries.owners, device=bits.device)
    inside = cells >= 0
    laid = bits.new_zeros(len(queries) * architecture.cells)
    laid = laid.index_add(0, owners[inside] * architecture.cells + cells[inside], (hits + misses)[inside])
    missed = bits.new_zeros(len(queries)).index_add(0, owners[inside], misses[inside])
    return laid.view(len(queries), -1) @ bits.flatten(1).T - missed[:, None]


def _perceptron(inputs: int, hidden: int, outputs: int) -> nn.Sequential:
    """Two layers that give 0 for everything until they are trained."""
    first, last = nn.Linear(inputs, hidden), nn.Linear(hidden, outputs)
    nn.init.zeros_(last.weight)
    nn.init.zeros_(last.bias)
    return nn.Sequential(first, nn.Tanh(), last)
