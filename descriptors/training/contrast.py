"""What networks are trained on: whose constellation is seen, among objects of its class in a map (InfoNCE).

The negatives are other objects of the same class, those of the same street among them. Each step has a new map with
new views of it. Oord et al., Representation Learning with Contrastive Predictive Coding, 2018, equation 4.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import cross_entropy

from descriptors.arrays import IntArray
from descriptors.constellation import Constellations, gather_constellations
from descriptors.descriptellation_lr.pairs import DescriptellationLRArchitecture
from descriptors.errors import DescriptorError
from descriptors.learned.networks import Architecture, VectorArchitecture, vectors_of
from descriptors.training.maps import TrainingMap, draw_map, with_classes_of
from descriptors.training.pair_contrast import PairSample, draw_pair_sample
from descriptors.training.views import draw_view


@dataclass(frozen=True, slots=True)
class ContrastTraining:
    """What is trained; the learning rate falls as a cosine to ``last_rate``.

    A step draws a map, noise of its objects, ``views`` of it and some objects of each, and compares these with
    ``objects_per_map`` of the map that are of the same classes.
    """

    architecture: Architecture = field(default_factory=DescriptellationLRArchitecture)
    epochs: int = 40
    learning_rate: float = 1e-2
    last_rate: float = 3e-4
    views: int = 3
    objects_per_map: int = 160
    validation_maps: int = 24
    seed: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """Objects of a map, and constellations of views with the places (Q,) of their objects among these."""

    constellations: Constellations
    queries: tuple[Constellations, ...]
    objects: IntArray

    def scores(self, network: nn.Module, device: torch.device) -> Tensor:
        """Squared distances (Q, B) of the vectors of queries from those in the map, negative.

        Raises:
            DescriptorError: the network of a user gives no vectors.
        """
        known = vectors_of(network, self.constellations, device)
        asked = torch.cat([vectors_of(network, query, device) for query in self.queries])
        squares = asked.square().sum(dim=1)[:, None] + known.square().sum(dim=1) - 2.0 * asked @ known.T
        # Unit vectors, which are at most 2 apart, reach 40 nats at this temperature.
        return -squares / 0.1

    def loss(self, scores: Tensor) -> Tensor:
        """The mean loss of the scores (Q, B)."""
        return cross_entropy(scores, torch.as_tensor(self.objects, device=scores.device))


def draw_sample(
    config: ContrastTraining, given: Sequence[TrainingMap], own_share: float, *, rng: np.random.Generator
) -> Sample | PairSample:
    """A map with views of it in which at least one object, or pair of objects, is seen as what it is.

    ``own_share``: how often of a given map. For a network with an embedding of classes, those of each map are dealt out
    anew among its rows.

    Raises:
        DescriptorError: the given maps have no place with objects enough.
    """
    for _ in range(1000):  # maps of a user may have no place with objects enough
        drawn = draw_map(given, own_share, rng=rng)
        sample: Sample | PairSample | None
        if isinstance(config.architecture, DescriptellationLRArchitecture):
            sample = draw_pair_sample(drawn, config.architecture, views=config.views, rng=rng)
        else:
            sample = _draw_constellations(config, config.architecture, drawn, rng=rng)
        if sample is not None:
            return sample
    raise DescriptorError("no place in the maps has enough objects to train on")


def _draw_constellations(
    config: ContrastTraining, architecture: VectorArchitecture, drawn: TrainingMap, *, rng: np.random.Generator
) -> Sample | None:
    """Views of a map; None if none shows an object as what it is."""
    drawn = with_classes_of(drawn, architecture.vocabulary_size, rng=rng)
    vocabulary, radius_m = tuple(map(str, range(drawn.classes))), architecture.radius_m
    noise_m = rng.normal(0.0, rng.uniform(0.0, 0.25), drawn.positions.shape)
    queries, objects = [], []
    for _ in range(config.views):
        view = draw_view(drawn, rng=rng)
        seen = np.flatnonzero((view.objects >= 0) & (drawn.labels[view.objects] == view.labels))
        if len(view.labels) < 4 or not len(seen):  # loops are closed by as many
            continue
        centres = rng.permutation(seen)[:16]
        queries.append(
            gather_constellations(view.positions, view.labels, vocabulary, radius_m=radius_m, centres=centres)
        )
        objects.append(view.objects[centres])
    if not queries:
        return None
    asked = np.unique(np.concatenate(objects))
    others = np.setdiff1d(np.flatnonzero(np.isin(drawn.labels, drawn.labels[asked])), asked)
    compared = np.concatenate([asked, rng.permutation(others)[: config.objects_per_map - len(asked)]])
    constellations = gather_constellations(
        drawn.positions + noise_m, drawn.labels, vocabulary, radius_m=radius_m, centres=compared
    )
    return Sample(constellations, tuple(queries), np.searchsorted(asked, np.concatenate(objects)))
