"""Graphs of constellations: neighbours and maxima over them as loops find them."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from descriptors.descriptellation.graph import (
    distances,
    edges,
    group_maximum,
    nearest,
    neighbourhoods_of,
    pairs_of,
)
from tests.descriptors.batches import batch


@pytest.mark.parametrize("length_m", [6.0, 18.0])
def test_edges_join_present_objects_within_the_threshold_and_each_with_itself(length_m):
    positions, _, present = batch((12, 1, 30, 2), 32)
    found = edges(positions, present, length_m)
    for row in range(4):
        count = int(present[row].sum())
        places = positions[row, :count].double().numpy()
        apart = np.linalg.norm(places[:, None] - places, axis=2)
        expected = np.zeros((32, 32), dtype=bool)
        expected[:count, :count] = (apart <= length_m * (1 + 1e-5)) | np.eye(count, dtype=bool)
        assert np.array_equal(found[row].numpy(), expected)


@pytest.mark.parametrize("length_m", [6.0, 25.0, 40.0, 1000.0])
def test_neighbourhoods_are_those_of_the_edges_whether_complete_or_not(length_m):
    positions, _, present = batch((12, 1, 30, 2), 32)
    features = torch.randn(45, 5, generator=torch.Generator().manual_seed(0))
    near = neighbourhoods_of(distances(positions), present, length_m)
    pairs = pairs_of(edges(positions, present, length_m), present)
    found = group_maximum(features, near.groups, near.count, near.members).index_select(0, near.of)
    assert torch.equal(found, group_maximum(features, pairs.objects, 45, pairs.neighbours))
    assert torch.equal(near.owners, pairs.owners)
    if length_m == 1000.0:
        assert len(near.members) == 45  # one neighbourhood for all objects of a constellation


def test_objects_that_are_all_at_the_threshold_are_neighbours_however_it_is_rounded():
    tetrahedron = torch.tensor([[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]])
    rotations = torch.linalg.qr(torch.randn(50, 3, 3, generator=torch.Generator().manual_seed(0))).Q
    positions = 7.3 * tetrahedron @ rotations
    for count in (2, 3, 4):
        assert edges(positions[:, :count], torch.ones(50, count, dtype=torch.bool), 7.3 * 8.0**0.5).all()


def test_distances_of_objects_side_by_side_and_far_out_are_exact_among_few_and_many():
    for count in (10, 40):
        generator = torch.Generator().manual_seed(count)
        points = 30.0 + 0.1 * torch.rand(2, count, 3, generator=generator)
        exact = (points.double()[:, :, None] - points.double()[:, None]).norm(dim=3)
        assert (distances(points).double() - exact).abs().max() < 1e-6


def test_the_nearest_are_those_of_a_sorted_list_and_all_that_tie_with_the_last():
    positions, _, present = batch((12, 3), 14)
    found = nearest(positions, present, 5)
    apart = np.linalg.norm(positions[0, :12, None].numpy() - positions[0, :12].numpy(), axis=2)
    for row in range(12):
        assert set(found[0, row].nonzero().flatten().tolist()) == set(np.argsort(apart[row])[:5])
    assert torch.equal(found[1], present[1][:, None] & present[1])
    square = torch.tensor([[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0], [3.0, 0.0]]])
    assert nearest(square, torch.ones(1, 6, dtype=torch.bool), 2)[0, 0].tolist() == [True] * 5 + [False]


def test_the_maximum_and_its_gradient_are_those_of_amax_with_ties_too():
    generator = torch.Generator().manual_seed(0)
    features = torch.randint(-3, 3, (9, 4), generator=generator).double().requires_grad_()
    connected = (torch.rand(1, 9, 9, generator=generator) < 0.4) | torch.eye(9, dtype=torch.bool)
    pairs = pairs_of(connected, torch.ones(1, 9, dtype=torch.bool))
    weights = torch.randn(9, 4, generator=generator, dtype=torch.float64)
    expected = torch.stack([features[connected[0, row]].amax(dim=0) for row in range(9)])
    found = group_maximum(features, pairs.objects, 9, pairs.neighbours)
    assert torch.equal(found, expected)
    gradients = [torch.autograd.grad((result * weights).sum(), features)[0] for result in (expected, found)]
    assert torch.allclose(*gradients, atol=1e-12)
