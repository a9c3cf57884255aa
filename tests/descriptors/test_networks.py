"""The networks: what they may not depend on, and their parts against loops that follow the equations."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor, nn

from descriptors.baselines.sgnet import ContextAttention, EdgeConvolution
from descriptors.descriptellation.graph import distances, edges, neighbourhoods_of, pairs_of
from descriptors.descriptellation.network import (
    AttentionPooling,
    Descriptellation,
    DescriptellationArchitecture,
    MaxRelativeConvolution,
)
from descriptors.learned.networks import NETWORKS, make_network
from tests.descriptors.batches import batch

every_network = pytest.mark.parametrize("name", sorted(NETWORKS))


def network(name: str) -> nn.Module:
    """A network whose running statistics are not those it started with, ready to describe."""
    torch.manual_seed(0)
    made = make_network(NETWORKS[name][0]())
    for seed in range(20):
        made(*batch((12, 9, 20, 3), 20, seed=seed))
    return made.eval()


@pytest.fixture(autouse=True)
def _one_thread():
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def close(a: Tensor, b: Tensor, tolerance: float = 1e-6) -> bool:
    return bool((a - b).abs().max() < tolerance)


@every_network
@torch.no_grad()
def test_padding_changes_nothing(name):
    counts = (12, 1, 20, 2)
    tight, roomy = batch(counts, 20), batch(counts, 47)
    strange = roomy[0].clone(), roomy[1].clone(), roomy[2]
    strange[0][~strange[2]] = 3.0
    strange[1][~strange[2]] = 5
    describe = network(name)
    assert close(describe(*tight), describe(*roomy))
    assert close(describe(*tight), describe(*strange))


@every_network
def test_padding_changes_no_gradient_and_no_result_in_training(name):
    describe = network(name).train()
    gradients = []
    for room in (20, 47):
        describe.zero_grad()
        describe(*batch((12, 1, 20, 2), room))[:, 0].sum().backward()
        gradients.append(torch.cat([parameter.grad.flatten() for parameter in describe.parameters()]))
    assert gradients[0].abs().max() > 1e-3
    assert close(gradients[0], gradients[1], 1e-4 * float(gradients[0].abs().max()))


@every_network
@torch.no_grad()
def test_the_order_of_the_other_objects_changes_nothing(name):
    positions, labels, present = batch((20, 14), 20, seed=3)
    order = torch.cat([torch.tensor([0]), 1 + torch.randperm(19, generator=torch.Generator().manual_seed(0))])
    describe = network(name)
    shuffled = describe(positions[:, order], labels[:, order], present[:, order])
    assert close(describe(positions, labels, present), shuffled, 1e-5)


@every_network
@torch.no_grad()
def test_a_class_and_a_position_matter(name):
    positions, labels, present = batch((12,), 12)
    describe = network(name)
    described = describe(positions, labels, present)
    relabelled = labels.clone()
    relabelled[0, 5] = (labels[0, 5] + 1) % 64
    moved = positions.clone()
    moved[0, 5, 0] += 5.0
    assert not close(described, describe(positions, relabelled, present), 1e-4)
    assert not close(described, describe(moved, labels, present), 1e-4)


@pytest.mark.parametrize("kind", ["position", "integer", "one_hot", "embedding"])
@torch.no_grad()
def test_only_the_input_without_classes_ignores_them(kind):
    torch.manual_seed(0)
    describe = Descriptellation(DescriptellationArchitecture(input=kind, layers=3)).eval()
    positions, labels, present = batch((12,), 12)
    same = close(describe(positions, labels, present), describe(positions, (labels + 7) % 64, present), 1e-5)
    assert same == (kind == "position")


@torch.no_grad()
def test_every_layer_of_the_backbone_adds_to_the_one_before():
    describe = network("descriptellation")
    given = batch((12, 5), 12)
    seen: list[Tensor] = []
    describe.fusion.register_forward_pre_hook(lambda _, inputs: seen.append(inputs[0]))
    describe(*given)
    layers = seen[0].chunk(14, dim=1)
    pairs = neighbourhoods_of(distances(given[0]), given[2], 72.7)
    for before, block, after in zip(layers[:-1], describe.backbone, layers[1:], strict=True):
        assert close(before + block(before, pairs), after, 1e-5)
        assert not close(before, after, 1e-3)


@torch.no_grad()
def test_the_max_relative_convolution_is_its_equation():
    torch.manual_seed(0)
    positions, _, present = batch((7, 5), 8)
    connected = edges(positions, present, 30.0)
    convolution = MaxRelativeConvolution(4, 6).eval()
    features = torch.randn(2, 8, 4)
    found = convolution(features[present], neighbourhoods_of(distances(positions), present, 30.0))
    expected = []
    for row, i in present.nonzero().tolist():
        relative = [features[row, j] - features[row, i] for j in range(8) if connected[row, i, j]]
        largest = torch.stack(relative).max(dim=0).values
        expected.append(convolution.perceptron(torch.cat([features[row, i], largest])[None])[0])
    assert close(found, torch.stack(expected), 1e-5)


@torch.no_grad()
def test_the_edge_convolution_is_its_equation():
    torch.manual_seed(0)
    positions, _, present = batch((7, 5), 8)
    connected = edges(positions, present, 30.0)
    pairs = pairs_of(connected, present)
    convolution = EdgeConvolution(4, 6).eval()
    features = torch.randn(2, 8, 4)
    weights = torch.cat([convolution.own.weight, convolution.relative.weight], dim=1)
    expected = []
    for row, i in present.nonzero().tolist():
        seen = [
            convolution.activation((weights @ torch.cat([features[row, i], features[row, j] - features[row, i]]))[None])
            for j in range(8)
            if connected[row, i, j]
        ]
        expected.append(torch.cat(seen).max(dim=0).values)
    assert close(convolution(features[present], pairs.objects, pairs.neighbours), torch.stack(expected), 1e-5)


@torch.no_grad()
def test_attention_pooling_is_equation_1():
    torch.manual_seed(0)
    _, _, present = batch((7, 1, 5), 8)
    pooling = AttentionPooling(4, 6)
    features = torch.randn(int(present.sum()), 4)
    expected, start = [], 0
    for count in (7, 1, 5):
        nodes = features[start : start + count]
        exponentials = [torch.exp(pooling.gate(node)) for node in nodes]
        parts = [e / sum(exponentials) * pooling.theta(node) for e, node in zip(exponentials, nodes, strict=True)]
        expected.append(torch.stack(parts).sum(dim=0))
        start += count
    assert close(pooling(features, present), torch.stack(expected), 1e-5)


@torch.no_grad()
def test_the_attention_of_the_semantic_graph_network_weighs_by_likeness_to_the_mean():
    torch.manual_seed(0)
    _, _, present = batch((7, 1), 8)
    pooling = ContextAttention(4)
    features = torch.randn(8, 4)
    expected = []
    for nodes in (features[:7], features[7:]):
        context = torch.tanh(pooling.context.weight @ nodes.mean(dim=0))
        expected.append(sum(torch.sigmoid(node @ context) * node for node in nodes))
    assert close(pooling(features, present), torch.stack(expected), 1e-5)
