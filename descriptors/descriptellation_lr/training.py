"""Training of the towers: whose constellation is seen, among all objects of its class in a map (InfoNCE).

The negatives are other objects of the same class, those of the same street among them. Each step takes a new map with
new views of it. Oord et al., Representation Learning with Contrastive Predictive Coding, 2018, equation 4.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors.torch import save
from torch import Tensor

from descriptors.constellation import Constellations, gather_constellations
from descriptors.descriptellation_lr.learned_likelihood import FORMAT, read_towers
from descriptors.descriptellation_lr.network import DescriptellationLRArchitecture, Towers, background_of, query_scores
from descriptors.descriptellation_lr.training_maps import TrainingMap, draw_map
from descriptors.descriptellation_lr.views import draw_view
from descriptors.errors import WeightsError
from descriptors.learned.training_folder import Stateful, TrainingFolder, replaced
from descriptors.learned.weights import with_sorted_header

STEPS_PER_EPOCH = 50
"""New maps before the weights are validated, half a minute's work."""
LEAST_SEEN = 4
"""Objects without which a view is drawn anew; loops are closed by as many."""
LEAST_BACKGROUND = 5
"""Objects of the map that give its background at least, as in a map in the making."""
LONGEST_STEP = 1.0
"""Norm to which gradients are clipped: one map with few objects does not undo what others taught."""
RANKS = (1, 5, 25)
OWN_SHARE = 0.5
"""Share of the steps that are on pieces of given maps, where there are any; the others keep what is true anywhere."""


@dataclass(frozen=True, slots=True)
class TowersTraining:
    """What is trained, by Adam with a learning rate that falls as a cosine to ``last_rate``.

    A step takes a map, noise of its objects up to ``map_noise_m``, ``views`` of it and ``objects_per_view`` of each,
    and compares these with ``objects_per_map`` of the map that are of the same classes.
    """

    architecture: DescriptellationLRArchitecture = field(default_factory=DescriptellationLRArchitecture)
    epochs: int = 8
    learning_rate: float = 1e-2
    last_rate: float = 3e-4
    map_noise_m: float = 0.25
    views: int = 3
    objects_per_view: int = 16
    objects_per_map: int = 160
    validation_maps: int = 24
    seed: int = 0

    def as_json(self) -> dict[str, Any]:
        """All of it, nested, as JSON holds it."""
        return dict(json.loads(json.dumps(asdict(self))))


def further_training(*, seed: int) -> TowersTraining:
    """How weights that are trained already are trained further: for a shorter time, in smaller steps, and with more
    validation maps, as the differences between epochs are small.
    """
    return TowersTraining(epochs=4, learning_rate=1e-3, last_rate=1e-4, validation_maps=96, seed=seed)


@dataclass(frozen=True, slots=True)
class TowersEpoch:
    """What an epoch of 50 steps achieved: mean loss, and the share of objects found among the first 1, 5 and 25.

    ``exact_top_5``: the same of views without noise. ``epoch`` 0: the weights from which a training went on, with no
    ``train_loss``.
    """

    epoch: int
    train_loss: float | None
    validation_loss: float
    validation_top_1: float
    validation_top_5: float
    validation_top_25: float
    exact_top_5: float
    seconds: float


@dataclass(frozen=True, slots=True)
class Step:
    """How far a training is: the share done, the loss of this step, and how long the rest takes at this pace."""

    done: float
    loss: float
    remaining_s: float


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """Objects of a map, and constellations of views with the places (Q,) of their objects among these.

    ``background`` (C, R): that of some of the map, for a map in the making is small at first.
    """

    constellations: Constellations
    background: NDArray[np.float64]
    queries: tuple[Constellations, ...]
    objects: NDArray[np.int64]


def best_epoch(epochs: Sequence[TowersEpoch]) -> TowersEpoch:
    """The one with the best top 5 on validation maps, of equals the first.

    Where weights were trained further, only epochs that find no fewer objects in exact views than these weights
    compete: training on noisy views may cost what exact ones had.
    """
    first = epochs[0]
    competing = [each for each in epochs if first.epoch > 0 or each.exact_top_5 >= first.exact_top_5]
    return max(competing, key=lambda each: each.validation_top_5)


def train_towers(
    config: TowersTraining,
    folder: Path,
    given: Sequence[TrainingMap] = (),
    *,
    start: Path | None = None,
    threads: int = 1,
    on_step: Callable[[Step], None] = lambda step: None,
) -> list[TowersEpoch]:
    """Train, or go on where an interrupted training of the same configuration and maps stopped.

    Half of all steps are on pieces of the ``given`` maps, if there are any, the others on simulated maps. After every
    epoch the folder holds a checkpoint, the curves, and the weights of the epoch with the best top 5 on validation
    maps, which are the same for every seed: simulated ones or, with ``start``, pieces of the given ones. Equal
    configurations give equal weights on a CPU.

    Args:
        config: what is trained.
        folder: for checkpoint, curves and weights.
        given: maps of one's own.
        start: weights to go on from instead of random ones. They compete with the epochs as epoch 0
            (:func:`best_epoch`), so that the result is no worse on views of the given maps than what it came from.
        threads: of torch.
        on_step: is told how far the training is.

    Raises:
        DescriptorError: the folder holds the checkpoint of another training, or one that cannot be read.
        WeightsError: ``start`` cannot be read, or is of another architecture.
    """
    torch.set_num_threads(threads)
    run = _Run(config, given)
    about = {**config.as_json(), "maps": run.maps_digest}
    if start is not None:
        run.go_on_from(start)
        about["start"] = hashlib.sha256(start.read_bytes()).hexdigest()
    kept = TrainingFolder(folder, TowersEpoch, about)
    run.epochs = kept.resume(run.parts)
    rng = np.random.default_rng(2**31)
    known, share = (given, 1.0) if start is not None else ((), 0.0)
    validation = [draw_sample(config, known, share, rng=rng) for _ in range(config.validation_maps)]
    exact = [draw_sample(config, known, share, rng=rng, is_exact=True) for _ in range(config.validation_maps)]
    if start is not None and not run.epochs:
        run.epochs.append(_validated(run.towers, validation, exact, 0, None, time.perf_counter()))
        _save(kept.weights, run.towers, about, run.epochs[-1])
    while run.trained < config.epochs:
        run.next_epoch(validation, exact, on_step)
        if run.epochs[-1] is best_epoch(run.epochs):
            _save(kept.weights, run.towers, about, run.epochs[-1])
        kept.save(run.epochs, run.parts)
    return run.epochs


def draw_sample(
    config: TowersTraining,
    given: Sequence[TrainingMap],
    own_share: float,
    *,
    rng: np.random.Generator,
    is_exact: bool = False,
) -> Sample:
    """A map with views of it in which at least one object is seen as what it is.

    ``own_share``: how often of a given map; ``is_exact``: neither map nor views have noise.
    """
    while True:
        drawn = draw_map(given, own_share, rng=rng)
        vocabulary = tuple(map(str, range(drawn.classes)))
        noise_m = rng.normal(0.0, 0.0 if is_exact else rng.uniform(0.0, config.map_noise_m), drawn.positions.shape)
        radius_m = config.architecture.radius_m
        queries, objects = [], []
        for _ in range(config.views):
            view = draw_view(drawn, rng=rng, is_exact=is_exact)
            if len(view.labels) < LEAST_SEEN:
                continue
            seen = np.flatnonzero(view.objects >= 0)
            seen = seen[drawn.labels[view.objects[seen]] == view.labels[seen]]
            if not len(seen):
                continue
            centres = rng.permutation(seen)[: config.objects_per_view]
            queries.append(
                gather_constellations(view.positions, view.labels, vocabulary, radius_m=radius_m, centres=centres)
            )
            objects.append(view.objects[centres])
        if queries:
            asked = np.unique(np.concatenate(objects))
            others = np.setdiff1d(np.flatnonzero(np.isin(drawn.labels, drawn.labels[asked])), asked)
            others = rng.permutation(others)[: config.objects_per_map - len(asked)]
            compared = np.concatenate([asked, others])
            constellations = gather_constellations(
                drawn.positions + noise_m, drawn.labels, vocabulary, radius_m=radius_m, centres=compared
            )
            counted = rng.permutation(len(compared))[: rng.integers(LEAST_BACKGROUND, len(compared) + LEAST_BACKGROUND)]
            background = background_of(constellations[counted], config.architecture.rings)
            return Sample(constellations, background, tuple(queries), np.searchsorted(asked, np.concatenate(objects)))


def scores_of(towers: Towers, sample: Sample) -> Tensor:
    """Scores (Q, B) of all objects of the map for each query, those of other classes out of the question."""
    nats = towers(sample.constellations, sample.background)
    scores = torch.cat([query_scores(nats, query, towers.rings) for query in sample.queries])
    labels = np.concatenate([query.centre_labels for query in sample.queries])
    other = torch.as_tensor(labels[:, None] != sample.constellations.centre_labels)
    return scores.masked_fill(other, -1e4)


class _Run:
    """The state of a training between two epochs."""

    def __init__(self, config: TowersTraining, given: Sequence[TrainingMap]) -> None:
        torch.manual_seed(config.seed)
        self._config = config
        self._given = given
        self.maps_digest = [[len(each), each.classes, round(float(each.positions.sum()), 3)] for each in given]
        self.towers = Towers(config.architecture)
        self._rng = np.random.default_rng(config.seed)
        self._optimizer = torch.optim.Adam(self.towers.parameters(), lr=config.learning_rate)
        self._schedule = torch.optim.lr_scheduler.CosineAnnealingLR(
            self._optimizer, config.epochs * STEPS_PER_EPOCH, eta_min=config.last_rate
        )
        self.epochs: list[TowersEpoch] = []
        self.parts: dict[str, Stateful] = {
            "towers": self.towers,
            "optimizer": self._optimizer,
            "schedule": self._schedule,
            "draws": _Draws(self._rng),
        }

    @property
    def trained(self) -> int:
        """Epochs so far."""
        return self.epochs[-1].epoch if self.epochs else 0

    def go_on_from(self, weights: Path) -> None:
        """Take these weights instead of random ones."""
        tensors, _ = read_towers(weights)
        try:
            self.towers.load_state_dict({name: torch.from_numpy(tensor) for name, tensor in tensors.items()})
        except RuntimeError as error:
            raise WeightsError(f"{weights}: of another architecture than {self._config.architecture}") from error

    def next_epoch(self, validation: list[Sample], exact: list[Sample], on_step: Callable[[Step], None]) -> None:
        """50 steps, and what they achieved."""
        started = time.perf_counter()
        losses: list[float] = []
        for step in range(STEPS_PER_EPOCH):
            losses.append(self._step(draw_sample(self._config, self._given, OWN_SHARE, rng=self._rng)))
            taken = self.trained * STEPS_PER_EPOCH + step + 1
            left = self._config.epochs * STEPS_PER_EPOCH - taken
            pace_s = (time.perf_counter() - started) / (step + 1)
            on_step(Step(taken / (taken + left), losses[-1], left * pace_s))
        number = self.trained + 1
        self.epochs.append(_validated(self.towers, validation, exact, number, float(np.mean(losses)), started))

    def _step(self, sample: Sample) -> float:
        loss = torch.nn.functional.cross_entropy(scores_of(self.towers, sample), torch.as_tensor(sample.objects))
        self._optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(self.towers.parameters(), LONGEST_STEP)
        self._optimizer.step()
        self._schedule.step()
        return float(loss.detach())


class _Draws:
    """The state of a generator of random numbers; its integers are too long for a tensor."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng

    def state_dict(self) -> str:
        return json.dumps(self._rng.bit_generator.state)

    def load_state_dict(self, state: str, /) -> None:
        self._rng.bit_generator.state = json.loads(state)


def _validated(
    towers: Towers,
    validation: list[Sample],
    exact: list[Sample],
    number: int,
    train_loss: float | None,
    started: float,
) -> TowersEpoch:
    loss, (top_1, top_5, top_25) = _validate(towers, validation)
    _, (_, exact_top_5, _) = _validate(towers, exact)
    return TowersEpoch(number, train_loss, loss, top_1, top_5, top_25, exact_top_5, time.perf_counter() - started)


def _validate(towers: Towers, validation: list[Sample]) -> tuple[float, list[float]]:
    """Mean loss, and the mean share of objects that are among the first of :data:`RANKS`."""
    losses, shares = [], []
    with torch.no_grad():
        for sample in validation:
            scores, objects = scores_of(towers, sample), torch.as_tensor(sample.objects)
            losses.append(float(torch.nn.functional.cross_entropy(scores, objects)))
            before = (~(scores <= scores.gather(1, objects[:, None]))).sum(dim=1)  # what is no number is before all
            shares.append([float((before < rank).float().mean()) for rank in RANKS])
    return float(np.mean(losses)), np.mean(shares, axis=0).tolist()


def _save(path: Path, towers: Towers, about: Mapping[str, Any], epoch: TowersEpoch) -> None:
    metrics = {key: value for key, value in asdict(epoch).items() if key != "seconds"}
    texts = {
        "format": FORMAT,
        "architecture": json.dumps(about["architecture"]),
        "training": json.dumps({key: value for key, value in about.items() if key != "maps"}),
        "given_maps": json.dumps(about["maps"]),
        "metrics": json.dumps(metrics),
        "code_version": json.dumps(importlib.metadata.version("descriptellation-slam")),
    }
    tensors = {name: tensor.contiguous() for name, tensor in towers.state_dict().items()}
    with replaced(path) as part:
        part.write_bytes(with_sorted_header(save(tensors, metadata=texts)))
