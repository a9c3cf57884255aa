"""The batch triplet loss: what a loop over all triplets says, with the gradient that belongs to it."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from descriptors.descriptellation.losses import batch_triplet_loss

MARGIN = 0.3


def drawn(*, seed: int, anchors: int = 5, views: int = 3, length: int = 4) -> tuple[Tensor, Tensor]:
    """Unit vectors (B, length), double, and their anchors (B,) in no order."""
    generator = torch.Generator().manual_seed(seed)
    vectors = torch.randn(anchors * views, length, generator=generator, dtype=torch.float64)
    numbers = torch.arange(anchors).repeat_interleave(views)[torch.randperm(anchors * views, generator=generator)]
    return vectors / vectors.norm(dim=1, keepdim=True), numbers


def triplets(vectors: Tensor, anchors: Tensor, margin: float) -> list[float]:
    """What each triplet violates the margin by, one after the other; below 0 where it does not."""
    count = len(anchors)
    return [
        margin + float((vectors[a] - vectors[p]).norm()) - float((vectors[a] - vectors[n]).norm())
        for a in range(count)
        for p in range(count)
        for n in range(count)
        if a != p and anchors[a] == anchors[p] and anchors[a] != anchors[n]
    ]


@pytest.mark.parametrize("margin", [0.05, MARGIN, 1.5])
@pytest.mark.parametrize("seed", range(5))
def test_it_is_the_mean_over_the_triplets_that_violate_the_margin(seed, margin):
    vectors, anchors = drawn(seed=seed)
    violations = [violation for violation in triplets(vectors, anchors, margin) if violation > 0.0]
    assert violations
    expected = sum(violations) / len(violations)
    assert float(batch_triplet_loss(vectors, anchors, margin)) == pytest.approx(expected, rel=1e-6)


def test_triplets_that_keep_the_margin_do_not_thin_it_out():
    vectors = torch.tensor([[0.0], [0.1], [0.2], [50.0], [50.0]], dtype=torch.float64)
    anchors = torch.tensor([0, 0, 1, 2, 2])
    violations = [violation for violation in triplets(vectors, anchors, MARGIN) if violation > 0.0]
    assert len(violations) == 2 < len(triplets(vectors, anchors, MARGIN))
    assert float(batch_triplet_loss(vectors, anchors, MARGIN)) == pytest.approx(sum(violations) / 2, rel=1e-6)


def test_anchors_of_different_numbers_of_views_count_by_their_triplets():
    vectors, _ = drawn(seed=1, anchors=3, views=3)
    anchors = torch.tensor([4, 4, 4, 4, 4, 7, 7, 9, 4])
    violations = [violation for violation in triplets(vectors, anchors, MARGIN) if violation > 0.0]
    expected = sum(violations) / len(violations)
    assert float(batch_triplet_loss(vectors, anchors, MARGIN)) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_the_gradient_is_the_numerical_one(seed):
    vectors, anchors = drawn(seed=seed)
    assert torch.autograd.gradcheck(lambda v: batch_triplet_loss(v, anchors, MARGIN), vectors.requires_grad_())


def test_a_step_against_the_gradient_pulls_views_together_and_pushes_others_away():
    vectors = torch.tensor([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]], dtype=torch.float64, requires_grad=True)
    anchors = torch.tensor([0, 0, 1])
    batch_triplet_loss(vectors, anchors, MARGIN).backward()
    moved = (vectors - 0.01 * vectors.grad).detach()
    assert (moved[0] - moved[1]).norm() < 1.0
    assert (moved[0] - moved[2]).norm() > 1.0
    assert batch_triplet_loss(moved, anchors, MARGIN) < batch_triplet_loss(vectors.detach(), anchors, MARGIN)


def test_nothing_is_left_to_learn_where_views_coincide_and_others_are_far():
    vectors = torch.eye(4).repeat_interleave(3, dim=0).requires_grad_()
    loss = batch_triplet_loss(vectors, torch.arange(4).repeat_interleave(3), MARGIN)
    loss.backward()
    assert float(loss.detach()) == 0.0
    assert torch.count_nonzero(vectors.grad) == 0


@pytest.mark.parametrize(
    "anchors", [[0, 1, 2, 3], [5, 5, 5, 5], [0], []], ids=["no positive", "no negative", "one vector", "no vector"]
)
def test_a_batch_without_triplets_costs_nothing(anchors):
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


def test_two_equal_views_among_others_have_finite_gradients():
    vectors, anchors = drawn(seed=8)
    first, second = torch.nonzero(anchors == 2).flatten()[:2]
    vectors[first] = vectors[second]
    vectors.requires_grad_()
    batch_triplet_loss(vectors, anchors, MARGIN).backward()
    assert torch.isfinite(vectors.grad).all()
    assert torch.count_nonzero(vectors.grad) > 0


def test_the_order_of_the_batch_and_the_names_of_the_anchors_change_nothing():
    vectors, anchors = drawn(seed=9)
    order = torch.randperm(len(anchors), generator=torch.Generator().manual_seed(1))
    loss = float(batch_triplet_loss(vectors, anchors, MARGIN))
    assert float(batch_triplet_loss(vectors[order], 100 - 7 * anchors[order], MARGIN)) == pytest.approx(loss, rel=1e-9)
