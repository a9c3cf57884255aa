"""The trainer of all networks: steps, validation, and the best weights."""

import hashlib
import importlib.metadata
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd
import torch

from descriptors.errors import DescriptorError
from descriptors.learned.networks import load_network, make_network
from descriptors.learned.weights import Weights, save_weights, write_file
from descriptors.training.contrast import ContrastTraining, PairSample, Sample, draw_sample
from descriptors.training.maps import TrainingMap

WEIGHTS, CURVES = "weights.safetensors", "curves.csv"

Epoch = dict[str, float | None]
"""What an epoch achieved: its number, the mean loss of its steps, the figures of the validation, and seconds.

Epoch 0 has the weights from which a training went on, and no loss of steps.
"""

STEPS_PER_EPOCH = 50
"""New maps before the weights are validated, half a minute's work."""


class Recipe:
    """What is trained on what: a network by Adam with its usual decay rates (0.9, 0.999).

    Half of all steps are on pieces of the ``given`` maps, if there are any, the others on simulated maps. The
    validation maps are the same for every seed: simulated ones or, with ``start``, pieces of the given ones.
    """

    def __init__(
        self,
        config: ContrastTraining,
        given: Sequence[TrainingMap] = (),
        start: Path | None = None,
        *,
        device: str = "cpu",
    ) -> None:
        """Make the network, from the weights ``start`` if there are any; these compete with the epochs.

        Raises:
            DescriptorError: the device cannot be used.
            WeightsError: ``start`` cannot be read, or is of another architecture.
        """
        self.config, self.given = config, given
        self.is_trained_further = start is not None
        maps = [[len(each), each.classes, round(float(each.positions.sum()), 3)] for each in given]
        self.identity = {**asdict(config), "maps": maps}
        """What is trained on what."""
        torch.manual_seed(config.seed)
        try:
            network = make_network(config.architecture) if start is None else load_network(start)
            self.network = network.to(torch.device(device))
        except (RuntimeError, AssertionError) as error:
            raise DescriptorError(f"device {device!r} cannot be used: {str(error).splitlines()[0]}") from error
        if start is not None:
            self.identity["start"] = hashlib.sha256(start.read_bytes()).hexdigest()
        self.optimizer = torch.optim.Adam(self.network.parameters(), lr=config.learning_rate)
        self.schedule = torch.optim.lr_scheduler.CosineAnnealingLR(
            self.optimizer, config.epochs * STEPS_PER_EPOCH, config.last_rate
        )
        self.rng = np.random.default_rng(config.seed)

    def step(self) -> float:
        """Draw a sample and change the weights by it; returns the loss."""
        # Half of the steps are on given maps, where there are any; the others keep what is true anywhere.
        sample = draw_sample(self.config, self.given, 0.5, rng=self.rng)
        loss = sample.loss(sample.scores(self.network))
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), 1.0)
        self.optimizer.step()
        self.schedule.step()
        return float(loss.detach())

    def validate(self) -> dict[str, float]:
        """Mean loss, and the mean share of objects among the first 1, 5 and 25."""
        self.network.eval()
        losses, places = [], []
        with torch.no_grad():
            for sample in self._validation:
                scores = sample.scores(self.network).cpu()
                objects = torch.as_tensor(sample.objects)
                losses.append(float(sample.loss(scores)))
                # NaN comes before all others.
                places.append((~(scores <= scores.gather(1, objects[:, None]))).sum(dim=1).numpy())
        shares = {
            f"validation_top_{rank}": float(np.mean([np.mean(before < rank) for before in places]))
            for rank in (1, 5, 25)
        }
        return {"validation_loss": float(np.mean(losses)), **shares}

    @cached_property
    def _validation(self) -> list[Sample | PairSample]:
        rng = np.random.default_rng(2**31)
        known, share = (self.given, 1.0) if self.is_trained_further else ((), 0.0)
        return [draw_sample(self.config, known, share, rng=rng) for _ in range(self.config.validation_maps)]


def best_of(epochs: Sequence[Epoch]) -> Epoch:
    """The epoch with the best top 5 on validation maps, of equals the first: its weights are kept."""
    return max(epochs, key=lambda each: each["validation_top_5"] or 0.0)


def train(
    recipe: Recipe, folder: Path, *, threads: int = 2, on_progress: Callable[[float], None] = lambda fraction: None
) -> list[Epoch]:
    """Train a network.

    After every epoch the folder holds the curves as CSV, and the weights of the best epoch so far. On a CPU with the
    same number of threads the same recipe gives the same weights.

    Args:
        recipe: what is trained on what.
        folder: made if it does not exist.
        threads: of torch, on a CPU.
        on_progress: called with the fraction done, in [0, 1], after each step.
    """
    torch.set_num_threads(threads)
    torch.use_deterministic_algorithms(True)
    folder.mkdir(parents=True, exist_ok=True)
    epochs = []
    for number in range(0 if recipe.is_trained_further else 1, recipe.config.epochs + 1):
        started = time.perf_counter()
        losses: list[float] = []
        recipe.network.train()
        while number and len(losses) < STEPS_PER_EPOCH:
            losses.append(recipe.step())
            on_progress((number - 1 + len(losses) / STEPS_PER_EPOCH) / recipe.config.epochs)
        train_loss = float(np.mean(losses)) if losses else None
        row: Epoch = {"epoch": number, "train_loss": train_loss, **recipe.validate()}
        epochs.append(row | {"seconds": time.perf_counter() - started})
        if best_of(epochs) is epochs[-1]:
            weights = Weights(
                tensors={name: tensor.detach().cpu().numpy() for name, tensor in recipe.network.state_dict().items()},
                architecture=asdict(recipe.config.architecture),
                training=recipe.identity,
                seed=recipe.config.seed,
                code_version=importlib.metadata.version("descriptellation-slam"),
                metrics=row,
            )
            save_weights(folder / WEIGHTS, weights)
        write_file(folder / CURVES, pd.DataFrame(epochs).to_csv(index=False, lineterminator="\n").encode())
    return epochs
