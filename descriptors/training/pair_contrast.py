"""What the likelihood ratio is trained on: which pair of a map a pair of a view is (InfoNCE).

The negatives are all pairs of the map of nearly the same length. The index compares pairs of the same classes only,
which are fewer in a map of this size.
Oord et al., Representation Learning with Contrastive Predictive Coding, 2018, equation 4.
"""

from dataclasses import dataclass

import numpy as np
import pandas as pd
import torch
from scipy.spatial import cKDTree
from torch import Tensor, nn
from torch.nn.functional import cross_entropy

from descriptors.arrays import BoolArray, FloatArray, IntArray
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
from descriptors.training.maps import TrainingMap
from descriptors.training.views import draw_view


@dataclass(frozen=True, slots=True, eq=False)
class PairSample:
    """Pairs ``known`` of a map, and ``queries``, pairs of views of it with the noise of each in spacings; ``objects``
    (Q,): which of the map each is; ``is_compared`` (Q, P): which ones it is told from, itself included.
    """

    known: Pairs
    queries: list[tuple[Pairs, FloatArray]]
    objects: IntArray
    is_compared: BoolArray

    def scores(self, network: nn.Module, device: torch.device) -> Tensor:
        """Log-likelihood ratios (Q, P) of all pairs of the map, those out of the question very low."""
        assert isinstance(network, DescriptellationLR)
        bits = network.bits(network(self.known, device))
        scores = []
        for query, sigmas in self.queries:
            hits, misses = network.worths(query_features(query, sigmas), device)
            scores.append(query_scores(bits, query, hits, misses, network.architecture))
        compared = torch.as_tensor(self.is_compared, device=device)
        return torch.cat(scores).masked_fill(~compared, -1e4)

    def loss(self, scores: Tensor) -> Tensor:
        """The mean loss of the scores (Q, P), those of the negatives raised as if there were 100,000 of them.

        So many pairs are of nearly the same length in a map of a million objects.
        """
        compared = torch.as_tensor(self.is_compared.sum(axis=1) - 1, dtype=scores.dtype, device=scores.device)
        raised = scores + torch.log(1e5 / compared.clamp(min=1.0))[:, None]
        right = torch.as_tensor(self.objects, device=scores.device)
        return cross_entropy(raised.scatter(1, right[:, None], scores.gather(1, right[:, None])), right)


def draw_pair_sample(
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
