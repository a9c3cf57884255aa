"""The paper's network: what it may not depend on, and its parts against loops that follow the equations."""

import pytest
import torch
from torch import Tensor, nn

from descriptors.descriptellation.network import (
    AttentionPooling,
    Descriptellation,
    DescriptellationArchitecture,
    MaxRelativeConvolution,
    maximum_of_each,
)
from tests.descriptors.batches import batch


@pytest.fixture
def describe() -> nn.Module:
    """A network whose running statistics are not those it started with, ready to describe."""
    torch.manual_seed(0)
    made = Descriptellation(DescriptellationArchitecture())
    for seed in range(5):
        made(*batch((12, 9, 20, 3), 20, seed=seed))
    return made.eval()


def close(a: Tensor, b: Tensor, tolerance: float = 1e-5) -> bool:
    return bool((a - b).abs().max() < tolerance)


@torch.no_grad()
def test_padding_and_order_change_nothing(describe):
    counts = (12, 1, 20, 2)
    expected = describe(*batch(counts, 20))
    positions, labels, present = batch(counts, 47)
    assert close(expected, describe(positions, labels, present))
    positions[~present], labels[~present] = 3.0, 5
    assert close(expected, describe(positions, labels, present))
    positions, labels, present = batch((20,), 20)
    order = torch.cat([torch.tensor([0]), 1 + torch.randperm(19)])
    shuffled = describe(positions[:, order], labels[:, order], present[:, order])
    assert close(describe(positions, labels, present), shuffled)


def test_padding_changes_no_gradient(describe):
    gradients = []
    for room in (20, 47):
        describe.train().zero_grad()
        describe(*batch((12, 1, 20, 2), room))[:, 0].sum().backward()
        gradients.append(torch.cat([parameter.grad.flatten() for parameter in describe.parameters()]))
    assert gradients[0].abs().max() > 1e-3
    assert close(gradients[0], gradients[1], 1e-4 * float(gradients[0].abs().max()))


@torch.no_grad()
def test_max_relative_convolution_is_its_equation():
    torch.manual_seed(0)
    convolution = MaxRelativeConvolution(4, 6).eval()
    features, owners = torch.randn(12, 4), torch.tensor([0] * 7 + [1] * 5)
    expected = []
    for row, owner in enumerate(owners.tolist()):
        largest = (features[owners == owner] - features[row]).amax(dim=0)
        expected.append(convolution.perceptron(torch.cat([features[row], largest])[None])[0])
    assert close(convolution(features, owners), torch.stack(expected))


def test_objects_that_share_a_maximum_share_its_gradient():
    features = torch.tensor([[1.0], [3.0], [3.0], [2.0]], requires_grad=True)
    largest = maximum_of_each(features, torch.tensor([0, 0, 0, 1]))
    assert largest.flatten().tolist() == [3.0, 3.0, 3.0, 2.0]
    largest.sum().backward()
    assert features.grad.flatten().tolist() == [0.0, 1.5, 1.5, 1.0]


@torch.no_grad()
def test_attention_pooling_is_equation_1():
    torch.manual_seed(0)
    _, _, present = batch((7, 1, 5), 8)
    pooling = AttentionPooling(4, 6)
    features = torch.randn(13, 4)
    expected = []
    for nodes in features.split([7, 1, 5]):
        weights = torch.softmax(pooling.gate(nodes), dim=0)
        expected.append((weights * pooling.theta(nodes)).sum(dim=0))
    assert close(pooling(features, present), torch.stack(expected))
