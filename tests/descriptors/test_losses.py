"""The batch triplet loss: the mean that a loop over all triplets finds, with its gradient."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from descriptors.training.triplets import batch_triplet_loss

MARGIN = 0.3


def drawn(*, seed: int, anchors: int = 5, views: int = 3) -> tuple[Tensor, Tensor]:
    """Unit vectors (B, 4), double, and their anchors (B,) in no order."""
    generator = torch.Generator().manual_seed(seed)
    vectors = torch.randn(anchors * views, 4, generator=generator, dtype=torch.float64)
    numbers = torch.arange(anchors).repeat_interleave(views)[torch.randperm(anchors * views, generator=generator)]
    return vectors / vectors.norm(dim=1, keepdim=True), numbers


def mean_of_violations(vectors: Tensor, anchors: Tensor, margin: float) -> float:
    count = range(len(anchors))
    violations = [
        margin + float((vectors[a] - vectors[p]).norm()) - float((vectors[a] - vectors[n]).norm())
        for a in count
        for p in count
        for n in count
        if a != p and anchors[a] == anchors[p] and anchors[a] != anchors[n]
    ]
    above = [each for each in violations if each > 0.0]
    return sum(above) / len(above)


@pytest.mark.parametrize("margin", [0.05, MARGIN, 1.5])
@pytest.mark.parametrize("seed", range(3))
def test_loss_is_the_mean_over_the_triplets_that_violate_the_margin(seed, margin):
    vectors, anchors = drawn(seed=seed)
    anchors[0] = anchors[1]  # not all anchors have as many views
    expected = mean_of_violations(vectors, anchors, margin)
    assert float(batch_triplet_loss(vectors, anchors, margin)) == pytest.approx(expected, rel=1e-6)


def test_gradient_is_the_numerical_one():
    vectors, anchors = drawn(seed=1)
    assert torch.autograd.gradcheck(lambda v: batch_triplet_loss(v, anchors, MARGIN), vectors.requires_grad_())


@pytest.mark.parametrize(
    "anchors", [[0, 1, 2, 3], [5, 5, 5, 5], [0], []], ids=["no positive", "no negative", "one vector", "no vector"]
)
def test_batch_without_triplets_costs_nothing(anchors):
    vectors = torch.randn(len(anchors), 3, generator=torch.Generator().manual_seed(0)).requires_grad_()
    loss = batch_triplet_loss(vectors, torch.tensor(anchors, dtype=torch.int64), MARGIN)
    loss.backward()
    assert float(loss.detach()) == 0.0
    assert torch.count_nonzero(vectors.grad) == 0


def test_equal_vectors_cost_the_margin_and_have_finite_gradients():
    vectors = torch.full((6, 4), 0.5).requires_grad_()
    loss = batch_triplet_loss(vectors, torch.tensor([0, 0, 0, 1, 1, 1]), MARGIN)
    loss.backward()
    assert float(loss.detach()) == pytest.approx(MARGIN, abs=1e-6)
    assert torch.isfinite(vectors.grad).all()
