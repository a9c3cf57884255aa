"""PointNet++ on constellations: a network that sees objects as points and knows no edges.

A baseline of the Descriptellation paper (Section IV-C), which takes the soft-max layer off the network of Qi et al.,
PointNet++: Deep Hierarchical Feature Learning on Point Sets in a Metric Space, 2017, and trains it like its own.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from descriptors.descriptellation.graph import edges, group_maximum, pairs_of
from descriptors.descriptellation.network import NodeInput, perceptron


@dataclass(frozen=True, slots=True)
class PointNetArchitecture:
    """Sizes of the network; ``length``: numbers of the descriptor, ``position_scale_m``: the distance that enters as 1.

    ``radius_m``: how far an object of the first level sees.
    """

    name: str = "pointnet"
    vocabulary_size: int = 64
    embedding_length: int = 3
    radius_m: float = 10.0
    group_channels: int = 64
    channels: int = 128
    length: int = 64
    position_scale_m: float = 10.0


class PointNet(nn.Module):
    """Two levels of set abstraction and a fully connected head.

    The first level groups the neighbours within ``radius_m`` around every object, where PointNet++ samples a few
    centroids of thousands of points: of some twenty objects none is to spare. The second level groups all objects.
    """

    def __init__(self, architecture: PointNetArchitecture | None = None) -> None:
        super().__init__()
        self.architecture = architecture or PointNetArchitecture()
        sizes = self.architecture
        self.node_input = NodeInput("embedding", sizes.vocabulary_size, sizes.embedding_length, sizes.position_scale_m)
        self.near = nn.Sequential(
            perceptron(3 + self.node_input.length, sizes.group_channels),
            perceptron(sizes.group_channels, sizes.group_channels),
        )
        self.whole = nn.Sequential(
            perceptron(3 + sizes.group_channels, sizes.channels), perceptron(sizes.channels, sizes.channels)
        )
        self.head = nn.Sequential(perceptron(sizes.channels, sizes.channels), nn.Linear(sizes.channels, sizes.length))

    def forward(self, positions: Tensor, labels: Tensor, present: Tensor) -> Tensor:
        """Unit vectors (B, length) of constellations as ``PaddedConstellations`` holds them.

        Args:
            positions: (B, N, 3) m, the centre first and at the origin.
            labels: (B, N) places in the vocabulary, below ``vocabulary_size``.
            present: (B, N) bool, where an object is.
        """
        pairs = pairs_of(edges(positions, present, self.architecture.radius_m), present)
        nodes = self.node_input(positions[present], labels[present])
        places = nodes[:, :3]
        beside = torch.cat(
            [places[pairs.neighbours] - places[pairs.objects], nodes.index_select(0, pairs.neighbours)], dim=1
        )
        near = group_maximum(self.near(beside), pairs.objects, len(nodes))
        whole = group_maximum(self.whole(torch.cat([places, near], dim=1)), pairs.owners, len(present))
        return functional.normalize(self.head(whole), dim=1)
