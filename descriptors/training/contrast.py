"""Training by contrast: whose constellation is seen, among all objects of its class in a map (InfoNCE).

The negatives are other objects of the same class, those of the same street among them. Each step has a new map with
new views of it. Oord et al., Representation Learning with Contrastive Predictive Coding, 2018, equation 4.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from descriptors.constellation import Constellations, gather_constellations
from descriptors.descriptellation_lr.network import DescriptellationLR, background_of, query_scores
from descriptors.descriptellation_lr.rings import DescriptellationLRArchitecture
from descriptors.errors import WeightsError
from descriptors.learned.weights import read_weights
from descriptors.training.folder import Epoch
from descriptors.training.maps import TrainingMap, draw_map
from descriptors.training.trainer import Recipe
from descriptors.training.views import draw_view

STEPS_PER_EPOCH = 50
"""New maps before the weights are validated, half a minute's work."""
MIN_SEEN = 4
"""Objects without which a view is drawn anew; loops are closed by as many."""
MIN_BACKGROUND = 5
"""Objects of the map that give its background at least, as in a map in the making."""
RANKS = (1, 5, 25)
OWN_SHARE = 0.5
"""Share of the steps that are on pieces of given maps, where there are any; the others keep what is true anywhere."""


@dataclass(frozen=True, slots=True)
class ContrastTraining:
    """What is trained; the learning rate falls as a cosine to ``last_rate``.

    A step draws a map, noise of its objects up to ``map_noise_m``, ``views`` of it and ``objects_per_view`` of each,
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


def further_training(*, seed: int) -> ContrastTraining:
    """How weights that are trained already are trained further: for a shorter time, in smaller steps, and with more
    validation maps, as the differences between epochs are small.
    """
    return ContrastTraining(epochs=4, learning_rate=1e-3, last_rate=1e-4, validation_maps=96, seed=seed)


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """Objects of a map, and constellations of views with the places (Q,) of their objects among these.

    ``background`` (C, R): that of some of the map, for a map in the making is small at first.
    """

    constellations: Constellations
    background: NDArray[np.float64]
    queries: tuple[Constellations, ...]
    objects: NDArray[np.int64]


class ContrastRecipe(Recipe):
    """Half of all steps are on pieces of the ``given`` maps, if there are any, the others on simulated maps.

    The validation maps are the same for every seed: simulated ones or, with ``start``, pieces of the given ones.
    """

    max_gradient = 1.0
    network: DescriptellationLR

    def __init__(self, config: ContrastTraining, given: Sequence[TrainingMap] = (), start: Path | None = None) -> None:
        """Make the network, from the weights ``start`` if there are any; these compete with the epochs.

        Raises:
            WeightsError: ``start`` cannot be read, or is of another architecture.
        """
        last, steps = config.last_rate / config.learning_rate, config.epochs * STEPS_PER_EPOCH
        super().__init__(
            config,
            lambda: DescriptellationLR(config.architecture),
            lambda step: last + (1.0 - last) * 0.5 * (1.0 + math.cos(math.pi * step / steps)),
            steps_per_epoch=STEPS_PER_EPOCH,
        )
        self._config, self._given = config, given
        self._rng = np.random.default_rng(config.seed)
        self.parts["draws"] = _Draws(self._rng)
        self.identity["maps"] = [[len(each), each.classes, round(float(each.positions.sum()), 3)] for each in given]
        if start is not None:
            self._load(start)
            self.identity["start"] = hashlib.sha256(start.read_bytes()).hexdigest()
            self.is_trained_further = True

    def batches(self, epoch: int) -> Iterator[Sample]:
        """Samples of new maps."""
        return (draw_sample(self._config, self._given, OWN_SHARE, rng=self._rng) for _ in range(STEPS_PER_EPOCH))

    def loss(self, batch: Sample) -> Tensor:
        """Cross-entropy of the object seen among those compared."""
        return torch.nn.functional.cross_entropy(scores_of(self.network, batch), torch.as_tensor(batch.objects))

    def validate(self) -> dict[str, float]:
        """Mean loss, and the mean share of objects among the first 1, 5 and 25; top 5 of views without noise, too."""
        validation, exact = self._validation
        loss, (top_1, top_5, top_25) = self._validate(validation)
        return {
            "validation_loss": loss,
            "validation_top_1": top_1,
            "validation_top_5": top_5,
            "validation_top_25": top_25,
            "exact_top_5": self._validate(exact)[1][1],
        }

    def best(self, epochs: Sequence[Epoch]) -> Epoch:
        """The one with the best top 5 on validation maps, of equals the first.

        Where weights were trained further, only epochs that find no fewer objects in exact views than these weights
        compete: training on noisy views may cost what exact ones had.
        """
        first = epochs[0]
        least = first.metrics["exact_top_5"] if first.epoch == 0 else 0.0
        competing = [each for each in epochs if each is first or each.metrics["exact_top_5"] >= least]
        return max(competing, key=lambda each: each.metrics["validation_top_5"])

    @cached_property
    def _validation(self) -> tuple[list[Sample], list[Sample]]:
        """Samples as they are trained on, and exact ones."""
        rng = np.random.default_rng(2**31)
        known, share = (self._given, 1.0) if self.is_trained_further else ((), 0.0)
        count = range(self._config.validation_maps)
        noisy = [draw_sample(self._config, known, share, rng=rng) for _ in count]
        return noisy, [draw_sample(self._config, known, share, rng=rng, is_exact=True) for _ in count]

    def _validate(self, samples: list[Sample]) -> tuple[float, list[float]]:
        losses, shares = [], []
        with torch.no_grad():
            for sample in samples:
                scores, objects = scores_of(self.network, sample), torch.as_tensor(sample.objects)
                losses.append(float(torch.nn.functional.cross_entropy(scores, objects)))
                before = (~(scores <= scores.gather(1, objects[:, None]))).sum(dim=1)  # NaN comes before all others
                shares.append([float((before < rank).float().mean()) for rank in RANKS])
        return float(np.mean(losses)), np.mean(shares, axis=0).tolist()

    def _load(self, start: Path) -> None:
        tensors = {name: torch.from_numpy(tensor.copy()) for name, tensor in read_weights(start).tensors.items()}
        try:
            self.network.load_state_dict(tensors)
        except RuntimeError as error:
            raise WeightsError(f"{start}: its architecture is not {self._config.architecture}") from error


class _Draws:
    """The state of a generator of random numbers; its integers are too long for a tensor."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng

    def state_dict(self) -> str:
        return json.dumps(self._rng.bit_generator.state)

    def load_state_dict(self, state: str, /) -> None:
        self._rng.bit_generator.state = json.loads(state)


def draw_sample(
    config: ContrastTraining,
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
            if len(view.labels) < MIN_SEEN:
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
            counted = rng.permutation(len(compared))[: rng.integers(MIN_BACKGROUND, len(compared) + MIN_BACKGROUND)]
            background = background_of(constellations[counted], config.architecture.rings)
            return Sample(constellations, background, tuple(queries), np.searchsorted(asked, np.concatenate(objects)))


def scores_of(network: DescriptellationLR, sample: Sample) -> Tensor:
    """Scores (Q, B) of all objects of the map for each query, those of other classes out of the question."""
    nats = network(sample.constellations, sample.background)
    scores = torch.cat([query_scores(nats, query, network.rings) for query in sample.queries])
    labels = np.concatenate([query.centre_labels for query in sample.queries])
    other = torch.as_tensor(labels[:, None] != sample.constellations.centre_labels)
    return scores.masked_fill(other, -1e4)
