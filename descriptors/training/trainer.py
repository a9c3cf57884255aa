"""The trainer of all networks: steps, validation, the best weights, and a checkpoint after each epoch."""

from __future__ import annotations

import importlib.metadata
import json
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from descriptors.errors import DescriptorError
from descriptors.learned.weights import Weights, save_weights
from descriptors.training.folder import Epoch, Stateful, TrainingFolder


@dataclass(frozen=True, slots=True)
class Step:
    """How far a training is: the share done, the loss of this step, and how long the rest takes at this pace."""

    done: float
    loss: float
    remaining_s: float


class Recipe(ABC):
    """What is trained on what: a network, its data and its loss, for a number of epochs of equally many steps.

    Its network is trained by Adam with its usual decay rates (0.9, 0.999).
    """

    extendable: frozenset[str] = frozenset()
    """Parts of the identity that may differ in a training that is resumed."""
    max_gradient = np.inf
    """Norm to which gradients are clipped."""

    def __init__(
        self,
        config: Any,
        make_network: Callable[[], nn.Module],
        decay: Callable[[int], float],
        *,
        steps_per_epoch: int,
        device: str = "cpu",
    ) -> None:
        """Make the network.

        Args:
            config: a dataclass with ``epochs``, ``learning_rate`` and ``seed``, which seeds torch.
            make_network: the network with random weights.
            decay: factor of the learning rate at each step from 0 on.
            steps_per_epoch: how many batches an epoch has.
            device: as torch names it.

        Raises:
            DescriptorError: the device cannot be used.
        """
        self.epochs: int = config.epochs
        self.seed: int = config.seed
        self.steps_per_epoch = steps_per_epoch
        self.identity: dict[str, Any] = dict(json.loads(json.dumps(asdict(config))))
        """What is trained on what, as JSON holds it."""
        torch.manual_seed(config.seed)
        try:
            self.device = torch.device(device)
            self.network = make_network().to(self.device)
        except (RuntimeError, AssertionError) as error:
            raise DescriptorError(f"device {device!r} cannot be used: {str(error).splitlines()[0]}") from error
        self.optimizer = torch.optim.Adam(self.network.parameters(), lr=config.learning_rate)
        self.schedule = torch.optim.lr_scheduler.LambdaLR(self.optimizer, decay)
        self.parts: dict[str, Stateful] = {
            "network": self.network,
            "optimizer": self.optimizer,
            "schedule": self.schedule,
        }
        """What changes during the training."""
        self.is_trained_further = False
        """Whether the weights before the first epoch compete, as epoch 0."""

    @abstractmethod
    def batches(self, epoch: int) -> Iterable[Any]:
        """The data of the steps of an epoch, counted from 0."""

    @abstractmethod
    def loss(self, batch: Any) -> Tensor:
        """The loss of the network on a batch."""

    @abstractmethod
    def validate(self) -> dict[str, float]:
        """Figures of the network in evaluation mode, by their names."""

    @abstractmethod
    def best(self, epochs: Sequence[Epoch]) -> Epoch:
        """The epoch whose weights are kept."""


def train(
    recipe: Recipe,
    folder: Path,
    *,
    threads: int = 2,
    on_step: Callable[[Step], None] = lambda step: None,
) -> list[Epoch]:
    """Train, or resume an interrupted training of the same recipe.

    After every epoch the folder holds a checkpoint, the curves as CSV, and the weights of the best epoch so far. On a
    CPU with the same number of threads the same recipe gives the same weights, interrupted or not.

    Args:
        recipe: what is trained on what.
        folder: made if it does not exist.
        threads: of torch, on a CPU.
        on_step: called after each step.

    Returns:
        All epochs, those before an interruption too.

    Raises:
        DescriptorError: the folder holds the checkpoint of another training, or one that cannot be read.
    """
    torch.set_num_threads(threads)
    torch.use_deterministic_algorithms(True)
    kept = TrainingFolder(folder, recipe.identity, recipe.extendable)
    epochs = kept.resume(recipe.parts, recipe.device)
    if recipe.is_trained_further and not epochs:
        epochs.append(_validated(recipe, 0, None, time.perf_counter()))
        _save_weights(kept.weights, recipe, epochs[-1])
    first = (epochs[-1].epoch if epochs else 0) + 1
    for number in range(first, recipe.epochs + 1):
        started = time.perf_counter()
        losses = _train_epoch(recipe, number - 1, on_step)
        epochs.append(_validated(recipe, number, float(np.mean(losses)), started))
        if recipe.best(epochs) is epochs[-1]:
            _save_weights(kept.weights, recipe, epochs[-1])
        kept.save(epochs, recipe.parts)
    return epochs


def _train_epoch(recipe: Recipe, number: int, on_step: Callable[[Step], None]) -> list[float]:
    started = time.perf_counter()
    recipe.network.train()
    losses: list[float] = []
    for batch in recipe.batches(number):
        loss = recipe.loss(batch)
        recipe.optimizer.zero_grad(set_to_none=True)
        loss.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(recipe.network.parameters(), recipe.max_gradient)
        recipe.optimizer.step()
        recipe.schedule.step()
        losses.append(float(loss.detach()))
        taken, steps = number * recipe.steps_per_epoch + len(losses), recipe.epochs * recipe.steps_per_epoch
        pace_s = (time.perf_counter() - started) / len(losses)
        on_step(Step(taken / steps, losses[-1], (steps - taken) * pace_s))
    return losses


def _validated(recipe: Recipe, number: int, train_loss: float | None, started: float) -> Epoch:
    recipe.network.eval()
    metrics = recipe.validate()
    return Epoch(number, train_loss, metrics, time.perf_counter() - started)


def _save_weights(path: Path, recipe: Recipe, epoch: Epoch) -> None:
    weights = Weights(
        tensors={name: tensor.detach().cpu().numpy() for name, tensor in recipe.network.state_dict().items()},
        architecture=asdict(recipe.network.architecture),  # type: ignore[call-overload]
        training=recipe.identity,
        seed=recipe.seed,
        code_version=importlib.metadata.version("descriptellation-slam"),
        metrics={name: value for name, value in epoch.as_row().items() if name != "seconds"},
    )
    save_weights(path, weights)
