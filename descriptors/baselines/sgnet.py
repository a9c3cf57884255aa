"""The graph embedding of SG_PR: one branch of edge convolutions on positions, another on classes.

Kong et al., Semantic Graph Based Place Recognition for 3D Point Clouds, IROS 2020; a baseline of the Descriptellation
paper (Section IV-C). Its network scores the similarity of two graphs by their embeddings; here the embedding itself
becomes the descriptor, and is trained like the others.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from descriptors.descriptellation.graph import group_maximum, nearest, pairs_of


@dataclass(frozen=True, slots=True)
class SGNetArchitecture:
    """Sizes of the network; ``length``: numbers of the descriptor, ``position_scale_m``: the distance that enters as 1.

    ``neighbours``: how many of the nearest objects an edge convolution takes, the object itself among them.
    ``channels``: what the first two edge convolutions of a branch give, ``last_channels``: what the third does.
    """

    name: str = "sgnet"
    vocabulary_size: int = 64
    neighbours: int = 10
    channels: int = 64
    last_channels: int = 32
    length: int = 64
    position_scale_m: float = 10.0


class SGNet(nn.Module):
    """Spatial and semantic branch, fusion of the two, attention pooling and a fully connected head."""

    def __init__(self, architecture: SGNetArchitecture | None = None) -> None:
        super().__init__()
        self.architecture = architecture or SGNetArchitecture()
        sizes = self.architecture
        last = sizes.last_channels
        channels = (sizes.channels, sizes.channels, last)
        self.spatial = Branch(3, channels, sizes.neighbours)
        self.semantic = Branch(sizes.vocabulary_size, channels, sizes.neighbours)
        self.fusion = leaky_perceptron(2 * last, last)
        self.pooling = ContextAttention(last)
        self.head = nn.Linear(last, sizes.length)

    def forward(self, positions: Tensor, labels: Tensor, present: Tensor) -> Tensor:
        """Unit vectors (B, length) of constellations as ``PaddedConstellations`` holds them.

        Args:
            positions: (B, N, 3) m, the centre first and at the origin.
            labels: (B, N) places in the vocabulary, below ``vocabulary_size``.
            present: (B, N) bool, where an object is.
        """
        places = positions[present] / self.architecture.position_scale_m
        classes = functional.one_hot(labels[present], self.architecture.vocabulary_size).to(places.dtype)
        features = self.fusion(torch.cat([self.spatial(places, present), self.semantic(classes, present)], dim=1))
        return functional.normalize(self.head(self.pooling(features, present)), dim=1)


class Branch(nn.Module):
    """Edge convolutions one after the other, each on a graph of its own input (SG_PR's and DGCNN's dynamic graph)."""

    def __init__(self, inputs: int, channels: tuple[int, ...], neighbours: int) -> None:
        super().__init__()
        self._neighbours = neighbours
        sizes = (inputs, *channels)
        self.convolutions = nn.ModuleList(EdgeConvolution(*pair) for pair in zip(sizes[:-1], channels, strict=True))

    def forward(self, features: Tensor, present: Tensor) -> Tensor:
        """Features (M, channels[-1]) of the objects of ``present`` (B, N) with ``features`` (M, inputs)."""
        for convolution in self.convolutions:
            points = features.new_zeros(*present.shape, features.shape[1])
            points[present] = features.detach()
            pairs = pairs_of(nearest(points, present, self._neighbours), present)
            features = convolution(features, pairs.objects, pairs.neighbours)
        return features


class EdgeConvolution(nn.Module):
    """EdgeConv: the maximum over neighbours j of ``MLP([x_i, x_j - x_i])`` (Wang et al., Dynamic Graph CNN, 2019)."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.own = nn.Linear(inputs, outputs, bias=False)
        self.relative = nn.Linear(inputs, outputs, bias=False)
        self.activation = nn.Sequential(nn.BatchNorm1d(outputs), nn.LeakyReLU(0.2))

    def forward(self, features: Tensor, objects: Tensor, neighbours: Tensor) -> Tensor:
        """New features (M, outputs) of objects with features (M, inputs), from E pairs of rows."""
        # The layer is linear in x_i and x_j, and there are several times fewer objects than pairs to apply it to.
        relative = self.relative(features)
        summed = (self.own(features) - relative).index_select(0, objects) + relative.index_select(0, neighbours)
        return group_maximum(self.activation(summed), objects, len(features))


class ContextAttention(nn.Module):
    """SG_PR's attention: objects weigh as much as they resemble the mean object of their constellation."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.context = nn.Linear(channels, channels, bias=False)

    def forward(self, features: Tensor, present: Tensor) -> Tensor:
        """Sums (B, channels) over the features (M, channels) of the objects of ``present`` (B, N), row by row."""
        owners = present.nonzero(as_tuple=True)[0]
        empty = features.new_zeros(len(present), features.shape[1])
        means = empty.index_add(0, owners, features) / present.sum(dim=1, keepdim=True)
        context: Tensor = torch.tanh(self.context(means)).index_select(0, owners)
        weights = torch.sigmoid((features * context).sum(dim=1, keepdim=True))
        return empty.index_add(0, owners, weights * features)


def leaky_perceptron(inputs: int, outputs: int) -> nn.Sequential:
    """A fully connected layer, normalised over the batch, its negative side flattened as in SG_PR."""
    return nn.Sequential(nn.Linear(inputs, outputs), nn.BatchNorm1d(outputs), nn.LeakyReLU(0.2))
