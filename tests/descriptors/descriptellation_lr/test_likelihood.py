"""The learned likelihood ratio: numpy computes what torch was trained to."""

from dataclasses import asdict

import numpy as np
import torch
from scipy.spatial import cKDTree

from descriptors.descriptellation_lr.likelihood import LearnedLikelihood
from descriptors.descriptellation_lr.network import DescriptellationLR, query_scores
from descriptors.descriptellation_lr.pairs import (
    DescriptellationLRArchitecture,
    Pairs,
    cells_of,
    find_ends,
    gather_pairs,
    query_features,
    spacing_m,
)
from descriptors.learned.weights import Weights, save_weights
from descriptors.registry import shipped_likelihood
from descriptors.training.maps import draw_street


def street(seed: int) -> Pairs:
    drawn = draw_street(rng=np.random.default_rng(seed))
    plane = drawn.positions[:, :2] / spacing_m(drawn.positions)
    tree = cKDTree(plane)
    return gather_pairs(
        plane, drawn.labels, find_ends(plane, drawn.labels, tree, 3)[:100], tree, DescriptellationLRArchitecture()
    )


def test_numpy_and_torch_compute_the_same_bits_and_nats(tmp_path) -> None:
    pairs, sigmas = street(1), np.full(100, 0.07)
    torch.manual_seed(0)
    network = DescriptellationLR(DescriptellationLRArchitecture())
    for name, parameter in network.named_parameters():
        if name.startswith(("gate", "worth")):
            torch.nn.init.normal_(parameter, 0.1, 0.2)
    tensors = {name: tensor.numpy() for name, tensor in network.state_dict().items()}
    save_weights(tmp_path / "lr.safetensors", Weights(tensors=tensors, architecture=asdict(network.architecture)))
    learned = LearnedLikelihood(tmp_path / "lr.safetensors")
    with torch.no_grad():
        logits = network(pairs).flatten(1).numpy()
        hits, misses = (nats.numpy() for nats in network.worths(query_features(pairs, sigmas)))
    bits = learned.bits(pairs)
    assert 0.01 < bits.mean() < 0.3
    assert np.mean(bits != (logits > 0.0)) < 0.005  # kernels are rounded
    np.testing.assert_allclose(np.stack(learned.worths(pairs, sigmas)), np.stack([hits, misses]), atol=1e-4)


def test_score_counts_hits_and_misses_inside_the_rings() -> None:
    pairs = street(2)
    sizes = DescriptellationLRArchitecture()
    cells = cells_of(pairs, sizes)
    bits = torch.zeros(2, sizes.cells)
    first = cells[pairs.owners == 0]
    bits[0, first[first >= 0][:2]] = 1.0
    worth = torch.ones(len(pairs.radii))
    scores = query_scores(bits.view(2, sizes.rings, sizes.sectors), pairs, 2.0 * worth, worth, sizes)
    inside = int((first >= 0).sum())
    assert scores[0].tolist() == [3.0 * len(set(first[first >= 0][:2])) - inside, -float(inside)]


def test_objects_near_their_counterparts_fall_into_set_cells_and_others_rarely() -> None:
    rng = np.random.default_rng(3)
    positions = rng.uniform(0.0, 20.0, (400, 2))
    labels = np.zeros(400, int)
    positions /= spacing_m(positions)
    tree = cKDTree(positions)
    ends = find_ends(positions, labels, tree, 3)
    learned = shipped_likelihood()
    bits = learned.bits(gather_pairs(positions, labels, ends, tree, learned.architecture))
    noisy = positions + rng.normal(0.0, 0.04, positions.shape)
    asked = gather_pairs(noisy, labels, ends, cKDTree(noisy), learned.architecture)
    cells, owners = cells_of(asked, learned.architecture), asked.owners
    inside = cells >= 0
    assert bits[owners[inside], cells[inside]].mean() > 0.75
    other = rng.permutation(len(ends))[owners[inside]]
    assert bits[other, cells[inside]].mean() < 0.3
    hits, misses = learned.worths(asked, np.full(len(ends), 0.05))
    assert hits.min() >= 0.0
    assert misses.min() >= 0.0
    assert np.median(hits) > 0.5
