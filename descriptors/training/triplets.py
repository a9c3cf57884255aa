"""Training by triplets on noisy views of simulated constellations (Descriptellation, Sections III-E and III-F)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from descriptors.descriptellation.network import DescriptellationArchitecture
from descriptors.learned.networks import Architecture, describe_padded, make_network, vectors_of
from descriptors.training.augmentation import AugmentationRates
from descriptors.training.dataset import ConstellationDataset, DatasetConfig, make_dataset
from descriptors.training.folder import Epoch
from descriptors.training.simulation import MapSimulation
from descriptors.training.top_k import top_k_ratio
from descriptors.training.trainer import Recipe


@dataclass(frozen=True, slots=True)
class TripletTraining:
    """What is trained on what.

    ``learning_rate`` is multiplied by ``decay`` every ``decay_epochs``, an interval that the paper leaves open.

    A batch holds all views of ``anchors_per_batch`` constellations. ``margin`` of the triplet loss, for unit vectors.
    ``top_k``: of the ratio by which the best epoch is chosen.
    """

    architecture: Architecture = field(default_factory=DescriptellationArchitecture)
    simulation: MapSimulation = field(default_factory=MapSimulation)
    augmentation: AugmentationRates = field(default_factory=AugmentationRates)
    dataset: DatasetConfig = field(default_factory=DatasetConfig)
    epochs: int = 100
    anchors_per_batch: int = 16
    learning_rate: float = 1e-3
    decay: float = 0.7
    decay_epochs: int = 10
    margin: float = 0.3
    top_k: int = 5
    seed: int = 0


class TripletRecipe(Recipe):
    """Views of one constellation are drawn together and those of others pushed apart."""

    extendable = frozenset({"epochs"})

    def __init__(self, config: TripletTraining, device: str = "cpu") -> None:
        """Make the network.

        Raises:
            DescriptorError: the device cannot be used.
        """
        steps = -(-config.dataset.anchors // config.anchors_per_batch)
        super().__init__(
            config,
            lambda: make_network(config.architecture),
            lambda step: config.decay ** (step // steps // config.decay_epochs),
            steps_per_epoch=steps,
            device=device,
        )
        self._config = config

    def batches(self, epoch: int) -> Iterator[tuple[ConstellationDataset, NDArray[np.int64]]]:
        """Rows of whole anchors, shuffled anew for every epoch."""
        return ((self._training, rows) for rows in self._shuffled(self._training, epoch))

    def loss(self, batch: tuple[ConstellationDataset, NDArray[np.int64]]) -> Tensor:
        """The batch triplet loss."""
        dataset, rows = batch
        vectors = vectors_of(self.network, dataset.constellations[rows], self.device)
        anchors = torch.as_tensor(dataset.anchors[rows], device=self.device)
        return batch_triplet_loss(vectors, anchors, self._config.margin)

    def validate(self) -> dict[str, float]:
        """The loss on other maps, and the top-k ratio on the training maps and on these."""
        config, validation = self._config, self._validation
        trained, described = (
            describe_padded(self.network, dataset.constellations, self.device)
            for dataset in (self._training, validation)
        )
        losses = [
            batch_triplet_loss(
                torch.as_tensor(described[rows]), torch.as_tensor(validation.anchors[rows]), config.margin
            )
            for rows in self._shuffled(validation, 0)
        ]
        return {
            "validation_loss": float(torch.stack(losses).mean()),
            "train_top_k": top_k_ratio(trained, self._training.anchors, config.top_k),
            "validation_top_k": top_k_ratio(described, validation.anchors, config.top_k),
        }

    def best(self, epochs: Sequence[Epoch]) -> Epoch:
        """The one with the best top-k ratio on other maps, of equals the first."""
        return max(epochs, key=lambda each: each.metrics["validation_top_k"])

    @cached_property
    def _training(self) -> ConstellationDataset:
        return self._dataset(2 * self.seed)

    @cached_property
    def _validation(self) -> ConstellationDataset:
        return self._dataset(2 * self.seed + 1)

    def _dataset(self, seed: int) -> ConstellationDataset:
        return make_dataset(self._config.simulation, self._config.augmentation, self._config.dataset, seed=seed)

    def _shuffled(self, dataset: ConstellationDataset, epoch: int) -> Iterator[NDArray[np.int64]]:
        rng = np.random.default_rng((self.seed, epoch))
        rows = np.argsort(rng.permutation(int(dataset.anchors.max()) + 1)[dataset.anchors], kind="stable")
        groups = np.split(rows, np.flatnonzero(np.diff(dataset.anchors[rows])) + 1)
        for start in range(0, len(groups), self._config.anchors_per_batch):
            yield np.concatenate(groups[start : start + self._config.anchors_per_batch])


def batch_triplet_loss(vectors: Tensor, anchors: Tensor, margin: float) -> Tensor:
    """Mean of ``margin + d(a, p) - d(a, n)`` over all triplets of the batch where it is above 0, Euclidean distances.

    Hermans et al., In Defense of the Triplet Loss for Person Re-Identification, 2017, equation 6 (batch all), averaged
    over the triplets that still violate the margin. Batch hard (equation 5) is what that paper prefers; on our views,
    the hardest of which are hopelessly noisy, it draws all vectors together first and learns more slowly.

    Args:
        vectors: (B, D) descriptors.
        anchors: (B,) which constellation each is a view of.
        margin: how much farther a negative should be than a positive.
    """
    same = anchors[:, None] == anchors[None, :]
    itself = torch.eye(len(anchors), dtype=torch.bool, device=anchors.device)
    distances = _distances(vectors)
    queries, positives = torch.nonzero(same & ~itself, as_tuple=True)
    violations = margin + distances[queries, positives][:, None] - distances[queries]  # (pairs, B)
    violations = violations.masked_fill(same[queries], 0.0).clamp(min=0.0)
    return violations.sum() / (violations.detach() > 0.0).sum().clamp(min=1)


def _distances(vectors: Tensor) -> Tensor:
    """(B, B). The square root has no gradient at 0, where equal vectors are."""
    squares = vectors.square().sum(dim=1)
    squared = squares[:, None] + squares[None, :] - 2.0 * vectors @ vectors.T
    return squared.clamp(min=1e-8).sqrt()
