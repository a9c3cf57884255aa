"""What networks are trained on: whose constellation is seen in a map, or which pair of objects (InfoNCE).

The negatives of an object are others of the same class, those of the same street among them. Each step has a new map
with new views of it. Oord et al., Representation Learning with Contrastive Predictive Coding, 2018, equation 4.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd
import torch
from scipy.spatial import cKDTree
from torch import Tensor, nn
from torch.nn.functional import cross_entropy

from descriptors.arrays import BoolArray, FloatArray, IntArray, frozen
from descriptors.constellation import Constellations, gather_constellations
from descriptors.descriptellation_lr.network import DescriptellationLR, query_scores
from descriptors.descriptellation_lr.pairs import (
    QUERY_PARTNERS,
    DescriptellationLRArchitecture,
    Pairs,
    find_ends,
    gather_pairs,
    length_tolerances,
    query_features,
    spacing_m,
)
from descriptors.errors import DescriptorError
from descriptors.learned.networks import Architecture, VectorArchitecture, vectors_of
from descriptors.training.maps import TrainingMap, draw_map, with_classes_of
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


@frozen
class Sample:
    """Objects of a map, and constellations of views with the places (Q,) of their objects among these."""

    constellations: Constellations
    queries: tuple[Constellations, ...]
    objects: IntArray

    def scores(self, network: nn.Module) -> Tensor:
        """Squared distances (Q, B) of the vectors of queries from those in the map, negative.

        Raises:
            DescriptorError: the network of a user gives no vectors.
        """
        known = vectors_of(network, self.constellations)
        asked = torch.cat([vectors_of(network, query) for query in self.queries])
        squares = asked.square().sum(dim=1)[:, None] + known.square().sum(dim=1) - 2.0 * asked @ known.T
        # Unit vectors, which are at most 2 apart, reach 40 nats at this temperature.
        return -squares / 0.1

    def loss(self, scores: Tensor) -> Tensor:
        """The mean loss of the scores (Q, B)."""
        return cross_entropy(scores, torch.as_tensor(self.objects, device=scores.device))


@frozen
class PairSample:
    """Pairs ``known`` of a map, and ``queries``, pairs of views of it with the noise of each in spacings; ``objects``
    (Q,): which of the map each is; ``is_compared`` (Q, P): the pairs that it is compared with, itself included.

    These are all pairs of the map of nearly the same length. The index compares pairs of the same classes only, which
    are fewer in a map of this size.
    """

    known: Pairs
    queries: list[tuple[Pairs, FloatArray]]
    objects: IntArray
    is_compared: BoolArray

    def scores(self, network: nn.Module) -> Tensor:
        """Log-likelihood ratios (Q, P) of all pairs of the map, those out of the question very low."""
        assert isinstance(network, DescriptellationLR)
        bits = network.bits(network(self.known))
        scores = []
        for query, sigmas in self.queries:
            hits, misses = network.worths(query_features(query, sigmas))
            scores.append(query_scores(bits, query, hits, misses, network.architecture))
        compared = torch.as_tensor(self.is_compared, device=bits.device)
        return torch.cat(scores).masked_fill(~compared, -1e4)

    def loss(self, scores: Tensor) -> Tensor:
        """The mean loss of the scores (Q, P), those of the negatives raised as if there were 100,000 of them.

        So many pairs are of nearly the same length in a map of a million objects.
        """
        compared = torch.as_tensor(self.is_compared.sum(axis=1) - 1, dtype=scores.dtype, device=scores.device)
        raised = scores + torch.log(1e5 / compared.clamp(min=1.0))[:, None]
        right = torch.as_tensor(self.objects, device=scores.device)
        return cross_entropy(raised.scatter(1, right[:, None], scores.gather(1, right[:, None])), right)


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
            sample = _draw_pairs(drawn, config.architecture, views=config.views, rng=rng)
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


def _draw_pairs(
    drawn: TrainingMap, architecture: DescriptellationLRArchitecture, *, views: int, rng: np.random.Generator
) -> PairSample | None:
    """Views of a map; None if none of their pairs is one of the map."""
    unit_m = spacing_m(drawn.positions)
    map_sigma = rng.uniform(0.0, 0.04)  # in spacings
    positions = drawn.positions[:, :2] / unit_m + rng.normal(0.0, map_sigma, (len(drawn), 2))
    tree = cKDTree(positions)
    ends = find_ends(positions, drawn.labels, tree, architecture.partners)
    if not len(ends):
        return None
    pairs_of_map = pd.MultiIndex.from_arrays(list(ends.T))
    queries, objects = list[tuple[Pairs, FloatArray]](), list[IntArray]()
    for _ in range(views):
        sigma = float(np.exp(rng.uniform(*np.log((0.01, 0.15)))))  # in spacings
        view = draw_view(drawn, rng=rng, sigma_m=sigma * unit_m)
        seen = view.positions[:, :2] / unit_m
        if len(seen) < 3:  # a pair, and an object beside it
            continue
        seen_tree = cKDTree(seen)
        asked = find_ends(seen, view.labels, seen_tree, QUERY_PARTNERS, both_ways=True)
        # In this direction; none of clutter is there.
        found = pairs_of_map.get_indexer(pd.MultiIndex.from_arrays(list(view.objects[asked].T)))
        is_known = (found >= 0) & (drawn.labels[view.objects[asked]] == view.labels[asked]).all(axis=1)
        rows = rng.permutation(np.flatnonzero(is_known))[:60]  # of one training step
        if len(rows):
            query = gather_pairs(seen, view.labels, asked[rows], seen_tree, architecture)
            queries.append((query, np.full(len(rows), np.hypot(view.sigma_m / unit_m, map_sigma))))
            objects.append(found[rows])
    if not queries:
        return None
    known = gather_pairs(positions, drawn.labels, ends, tree, architecture)
    right, sigmas = np.concatenate(objects), np.concatenate([sigmas for _, sigmas in queries])
    lengths = np.concatenate([query.lengths for query, _ in queries])
    is_compared = np.abs(lengths[:, None] - known.lengths) <= length_tolerances(sigmas)[:, None]
    is_compared[np.arange(len(right)), right] = True
    return PairSample(known, queries, right, is_compared)
