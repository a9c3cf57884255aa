"""The Descriptellation network: a deep graph convolution network that turns a constellation into a vector.

Xing et al., Descriptellation: Deep Learned Constellation Descriptors, Section III-B and Figure 3, on the backbone of
Li et al., DeepGCNs: Can GCNs Go as Deep as CNNs?, ICCV 2019.

The paper joins objects that are nearer than the mean distance of two objects of the map. That is more than the diameter
of a constellation in all maps but the smallest, so all constellations are complete graphs here.
"""

import torch
from pydantic import ConfigDict
from pydantic.dataclasses import dataclass
from torch import Tensor, nn


@dataclass(frozen=True, slots=True, config=ConfigDict(extra="forbid"))
class DescriptellationArchitecture:
    """Sizes of the network; ``length``: numbers of the descriptor, ``radius_m``: how far neighbours count."""

    name: str = "descriptellation"
    vocabulary_size: int = 64
    embedding_length: int = 3
    layers: int = 14
    channels: int = 32
    fusion: int = 128
    length: int = 64
    radius_m: float = 30.0


class Descriptellation(nn.Module):
    """Label embedding, ResGCN backbone, fusion block, prediction block and global attention pooling."""

    def __init__(self, architecture: DescriptellationArchitecture) -> None:
        super().__init__()
        self.architecture = sizes = architecture
        # Files of weights know the embedding of the classes by these two names.
        self.node_input = nn.ModuleDict({"embedding": nn.Embedding(sizes.vocabulary_size, sizes.embedding_length)})
        self.head = MaxRelativeConvolution(3 + sizes.embedding_length, sizes.channels)
        self.backbone = nn.ModuleList(
            MaxRelativeConvolution(sizes.channels, sizes.channels) for _ in range(sizes.layers - 1)
        )
        gathered = sizes.channels * sizes.layers
        self.fusion = perceptron(gathered, sizes.fusion)
        self.prediction = nn.Sequential(
            perceptron(gathered + sizes.fusion, 2 * sizes.length), perceptron(2 * sizes.length, sizes.length)
        )
        self.pooling = AttentionPooling(sizes.length, sizes.length)

    def forward(self, positions: Tensor, labels: Tensor, present: Tensor) -> Tensor:
        """Vectors (B, length) of padded constellations, of any length.

        Args:
            positions: (B, N, 3) m, the centre first and at the origin.
            labels: (B, N) places in the vocabulary, below ``vocabulary_size``.
            present: (B, N) bool, where an object is.
        """
        owners = present.nonzero(as_tuple=True)[0]
        objects = torch.cat([positions[present], self.node_input["embedding"](labels[present])], dim=1)
        layers = [self.head(objects, owners)]
        for block in self.backbone:
            layers.append(layers[-1] + block(layers[-1], owners))
        gathered = torch.cat(layers, dim=1)
        fused = maximum_of_each(self.fusion(gathered), owners)
        pooled: Tensor = self.pooling(self.prediction(torch.cat([fused, gathered], dim=1)), present)
        return pooled


class MaxRelativeConvolution(nn.Module):
    """Max-relative graph convolution (DeepGCNs): ``MLP([x_i, max_j (x_j - x_i)])`` over neighbours j."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.perceptron = perceptron(2 * inputs, outputs)

    def forward(self, features: Tensor, owners: Tensor) -> Tensor:
        """New features (M, outputs) of objects with features (M, inputs), which belong to constellations (M,)."""
        # x_i does not depend on j, so the difference is taken once for each object and not for each pair.
        relative = maximum_of_each(features, owners) - features
        updated: Tensor = self.perceptron(torch.cat([features, relative], dim=1))
        return updated


class AttentionPooling(nn.Module):
    """Equation 1: the sum over the objects of ``softmax(gate(x_n)) * theta(x_n)``, channel by channel."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        # The equation leaves open whether an object has one weight or one for each channel, which it multiplies
        # element by element. One for each found as many matches after two thirds of the training steps.
        self.gate = nn.Linear(inputs, outputs)
        self.theta = nn.Linear(inputs, outputs)

    def forward(self, features: Tensor, present: Tensor) -> Tensor:
        """Sums (B, outputs) over the features (M, inputs) of the objects of ``present`` (B, N), row by row."""
        padded = features.new_full((*present.shape, self.gate.out_features), -torch.inf)
        weights = padded.masked_scatter(present[:, :, None], self.gate(features)).softmax(dim=1)[present]
        owners = present.nonzero(as_tuple=True)[0]
        weighted: Tensor = weights * self.theta(features)
        return weighted.new_zeros(len(present), weighted.shape[1]).index_add(0, owners, weighted)


def maximum_of_each(features: Tensor, owners: Tensor) -> Tensor:
    """For each object (M, C) the largest value of each channel in its constellation, numbered by ``owners`` (M,)."""
    largest = features.new_full((int(owners.max()) + 1, features.shape[1]), -torch.inf)
    largest = largest.scatter_reduce(0, owners[:, None].expand_as(features), features, "amax")
    return largest.index_select(0, owners)


def perceptron(inputs: int, outputs: int) -> nn.Sequential:
    """A fully connected layer, normalised and rectified."""
    # Over the batch as in DeepGCNs, padding being left out before. Over the channels of each object instead, training
    # took about twice the steps to find as many matches. Only in training mode does a result depend on the batch.
    return nn.Sequential(nn.Linear(inputs, outputs), nn.BatchNorm1d(outputs), nn.ReLU())
