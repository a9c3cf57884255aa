"""The Descriptellation network: a deep graph convolution network that turns a constellation into a vector.

Xing et al., Descriptellation: Deep Learned Constellation Descriptors, Section III-B and Figure 3, on the backbone of
Li et al., DeepGCNs: Can GCNs Go as Deep as CNNs?, ICCV 2019.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor, nn
from torch.nn import functional

from descriptors.descriptellation.graph import Neighbourhoods, distances, group_maximum, neighbourhoods_of

InputKind = Literal["position", "integer", "one_hot", "embedding"]


@dataclass(frozen=True, slots=True)
class DescriptellationArchitecture:
    """Sizes of the network; ``input`` names the four kinds of input of the paper's ablation (Section IV-G).

    ``length``: numbers of the descriptor. ``edge_length_m``: threshold of the graphs in training, the mean distance of
    two objects of a simulated map, with which all constellations of 30 m are complete graphs.
    """

    name: str = "descriptellation"
    input: InputKind = "embedding"
    vocabulary_size: int = 64
    embedding_length: int = 3
    layers: int = 14
    channels: int = 32
    fusion: int = 128
    length: int = 64
    edge_length_m: float = 72.7


class Descriptellation(nn.Module):
    """Label embedding, ResGCN backbone, fusion block, prediction block and global attention pooling."""

    def __init__(self, architecture: DescriptellationArchitecture | None = None) -> None:
        super().__init__()
        self.architecture = architecture or DescriptellationArchitecture()
        sizes = self.architecture
        self.edge_length_m = sizes.edge_length_m
        """Threshold of the graphs: the mean distance of two objects of the map that is described."""
        self.node_input = NodeInput(sizes.input, sizes.vocabulary_size, sizes.embedding_length)
        self.head = MaxRelativeConvolution(self.node_input.length, sizes.channels)
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
        """Vectors (B, length) of constellations as ``PaddedConstellations`` holds them, of any length.

        Args:
            positions: (B, N, 3) m, the centre first and at the origin.
            labels: (B, N) places in the vocabulary, below ``vocabulary_size``.
            present: (B, N) bool, where an object is.
        """
        near = neighbourhoods_of(distances(positions), present, self.edge_length_m)
        layers = [self.head(self.node_input(positions[present], labels[present]), near)]
        for block in self.backbone:
            layers.append(layers[-1] + block(layers[-1], near))
        gathered = torch.cat(layers, dim=1)
        fused = group_maximum(self.fusion(gathered), near.owners, len(present))
        predicted = self.prediction(torch.cat([fused.index_select(0, near.owners), gathered], dim=1))
        pooled: Tensor = self.pooling(predicted, present)
        return pooled


class NodeInput(nn.Module):
    """What the network is given of an object: its position, and, but for ``position``, its class."""

    def __init__(
        self, kind: InputKind, vocabulary_size: int, embedding_length: int, position_scale_m: float = 1.0
    ) -> None:
        super().__init__()
        self._position_scale_m = position_scale_m
        self._kind = kind
        self._vocabulary_size = vocabulary_size
        self.length = 3 + {"position": 0, "integer": 1, "one_hot": vocabulary_size, "embedding": embedding_length}[kind]
        if kind == "embedding":
            self.embedding = nn.Embedding(vocabulary_size, embedding_length)

    def forward(self, positions: Tensor, labels: Tensor) -> Tensor:
        """Features (M, length) of M objects at ``positions`` (M, 3) m with ``labels`` (M,)."""
        scaled = positions / self._position_scale_m
        if self._kind == "position":
            return scaled
        return torch.cat([scaled, self._classes(labels).to(scaled.dtype)], dim=1)

    def _classes(self, labels: Tensor) -> Tensor:
        if self._kind == "integer":
            return labels[:, None] + 1
        if self._kind == "one_hot":
            return functional.one_hot(labels, self._vocabulary_size)
        embedded: Tensor = self.embedding(labels)
        return embedded


class MaxRelativeConvolution(nn.Module):
    """Max-relative graph convolution (DeepGCNs): ``MLP([x_i, max_j (x_j - x_i)])`` over neighbours j."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.perceptron = perceptron(2 * inputs, outputs)

    def forward(self, features: Tensor, near: Neighbourhoods) -> Tensor:
        """New features (M, outputs) of objects with features (M, inputs)."""
        # x_i does not depend on j, so the difference is taken once for each object and not for each pair.
        largest = group_maximum(features, near.groups, near.count, near.members).index_select(0, near.of)
        updated: Tensor = self.perceptron(torch.cat([features, largest - features], dim=1))
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


def perceptron(inputs: int, outputs: int) -> nn.Sequential:
    """A fully connected layer, normalised and rectified."""
    # Over the batch as in DeepGCNs, padding being left out before. Over the channels of each object instead, training
    # took about twice the steps to find as many matches. Only in training mode does a result depend on the batch.
    return nn.Sequential(nn.Linear(inputs, outputs), nn.BatchNorm1d(outputs), nn.ReLU())
