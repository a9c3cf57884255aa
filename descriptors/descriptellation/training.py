"""Training of a descriptor network on simulated maps (Descriptellation, Sections III-E and III-F)."""

from __future__ import annotations

import importlib.metadata
import json
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from descriptors.descriptellation.augmentation import AugmentationRates
from descriptors.descriptellation.dataset import ConstellationDataset, DatasetConfig, make_dataset
from descriptors.descriptellation.losses import batch_triplet_loss
from descriptors.descriptellation.network import DescriptellationArchitecture
from descriptors.descriptellation.simulation import MapSimulation
from descriptors.errors import DescriptorError
from descriptors.learned.architectures import Architecture, make_network
from descriptors.learned.inference import describe_padded, tensors
from descriptors.learned.padded import PaddedConstellations
from descriptors.learned.training_folder import Stateful, TrainingFolder
from descriptors.learned.weights import WeightsMetadata, save_weights
from descriptors.top_k import top_k_ratio


@dataclass(frozen=True, slots=True)
class TrainingConfig:
    """What is trained on what, by Adam with its usual decay rates (0.9, 0.999).

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

    def as_json(self) -> dict[str, Any]:
        """All of it, nested, as JSON holds it."""
        return dict(json.loads(json.dumps(asdict(self))))


@dataclass(frozen=True, slots=True)
class Epoch:
    """What an epoch achieved: losses, and the share of views with another view of theirs among the nearest."""

    epoch: int
    learning_rate: float
    train_loss: float
    validation_loss: float
    train_top_k: float
    validation_top_k: float
    seconds: float


def train_network(
    config: TrainingConfig,
    folder: Path,
    *,
    device: str = "cpu",
    threads: int = 2,
    on_epoch: Callable[[Epoch], None] = lambda epoch: None,
    on_batch: Callable[[float, float, float], None] = lambda done, loss, remaining_s: None,
) -> list[Epoch]:
    """Train, or go on where an interrupted training of the same configuration stopped.

    After every epoch the folder holds a checkpoint, the curves as CSV, and the weights of the best epoch so far. On a
    CPU with the same number of threads the same configuration gives the same weights, interrupted or not.

    Args:
        config: what is trained on what.
        folder: made if it does not exist.
        device: as torch names it.
        threads: of torch, on a CPU.
        on_epoch: called with every epoch that ends.
        on_batch: called after each batch with the share done, its loss, and how many seconds the rest takes.

    Returns:
        All epochs, those before an interruption too.

    Raises:
        DescriptorError: the device cannot be used, or the folder holds the checkpoint of another configuration, or one
            that cannot be read.
    """
    torch.set_num_threads(threads)
    torch.use_deterministic_algorithms(True)
    run = _Run(config, device)
    kept = TrainingFolder(folder, Epoch, config.as_json(), frozenset({"epochs"}))
    run.epochs = kept.resume(run.parts, run.device)
    training = make_dataset(config.simulation, config.augmentation, config.dataset, seed=2 * config.seed)
    validation = make_dataset(config.simulation, config.augmentation, config.dataset, seed=2 * config.seed + 1)
    while len(run.epochs) < config.epochs:
        epoch = run.next_epoch(training, validation, on_batch)
        if epoch is max(run.epochs, key=lambda each: each.validation_top_k):  # of equals the first
            save_weights(kept.weights, run.network, _metadata(config, epoch))
        kept.save(run.epochs, run.parts)
        on_epoch(epoch)
    return run.epochs


class _Run:
    """The state of a training between two epochs."""

    def __init__(self, config: TrainingConfig, device: str) -> None:
        torch.manual_seed(config.seed)
        self._config = config
        try:
            self.device = torch.device(device)
            self.network: nn.Module = make_network(config.architecture).to(self.device)
        except (RuntimeError, AssertionError) as error:
            raise DescriptorError(f"device {device!r} cannot be used: {str(error).splitlines()[0]}") from error
        self._optimizer = torch.optim.Adam(self.network.parameters(), lr=config.learning_rate)
        self.epochs: list[Epoch] = []
        self.parts: dict[str, Stateful] = {"network": self.network, "optimizer": self._optimizer}

    def next_epoch(
        self,
        training: ConstellationDataset,
        validation: ConstellationDataset,
        on_batch: Callable[[float, float, float], None],
    ) -> Epoch:
        started = time.perf_counter()
        number = len(self.epochs)
        learning_rate = self._config.learning_rate * self._config.decay ** (number // self._config.decay_epochs)
        for group in self._optimizer.param_groups:
            group["lr"] = learning_rate
        self.network.train()
        losses: list[float] = []
        batches = list(self._batches(training.anchors, number))
        for rows in batches:
            loss = self._loss(training.constellations[rows], training.anchors[rows])
            self._optimizer.zero_grad(set_to_none=True)
            loss.backward()  # type: ignore[no-untyped-call]
            self._optimizer.step()
            losses.append(float(loss.detach()))
            taken = number + len(losses) / len(batches)
            pace_s = (time.perf_counter() - started) * len(batches) / len(losses)
            on_batch(taken / self._config.epochs, losses[-1], (self._config.epochs - taken) * pace_s)
        self.network.eval()
        described = self._describe(validation)
        epoch = Epoch(
            number + 1,
            learning_rate,
            float(np.mean(losses)),
            self._mean_loss(described, validation),
            top_k_ratio(self._describe(training), training.anchors, self._config.top_k),
            top_k_ratio(described, validation.anchors, self._config.top_k),
            time.perf_counter() - started,
        )
        self.epochs.append(epoch)
        return epoch

    def _batches(self, anchors: NDArray[np.int64], number: int) -> Iterator[NDArray[np.int64]]:
        """Rows of whole anchors, shuffled anew for every epoch."""
        rng = np.random.default_rng((self._config.seed, number))
        rows = np.argsort(rng.permutation(int(anchors.max()) + 1)[anchors], kind="stable")
        ends = np.flatnonzero(np.diff(anchors[rows])) + 1
        groups = np.split(rows, ends)
        for start in range(0, len(groups), self._config.anchors_per_batch):
            yield np.concatenate(groups[start : start + self._config.anchors_per_batch])

    def _loss(self, constellations: PaddedConstellations, anchors: NDArray[np.int64]) -> torch.Tensor:
        vectors = self.network(*tensors(constellations, self.device))
        return batch_triplet_loss(vectors, torch.as_tensor(anchors, device=self.device), self._config.margin)

    def _describe(self, dataset: ConstellationDataset) -> NDArray[np.float32]:
        return describe_padded(self.network, dataset.constellations, self.device)

    def _mean_loss(self, vectors: NDArray[np.float32], dataset: ConstellationDataset) -> float:
        """Of the batches that the first epoch would draw."""
        losses = [
            batch_triplet_loss(
                torch.as_tensor(vectors[rows]), torch.as_tensor(dataset.anchors[rows]), self._config.margin
            )
            for rows in self._batches(dataset.anchors, 0)
        ]
        return float(torch.stack(losses).mean())


def _metadata(config: TrainingConfig, epoch: Epoch) -> WeightsMetadata:
    version = importlib.metadata.version("descriptellation-slam")
    metrics = {key: value for key, value in asdict(epoch).items() if key != "seconds"}
    return WeightsMetadata(training=config.as_json(), seed=config.seed, code_version=version, metrics=metrics)
