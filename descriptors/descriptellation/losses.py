"""The batch triplet loss that pulls views of one constellation together and pushes others away."""

from __future__ import annotations

import torch
from torch import Tensor


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
