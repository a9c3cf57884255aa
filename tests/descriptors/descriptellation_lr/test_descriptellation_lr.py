"""The learned likelihood: numpy and torch agree, a sensor may turn, and training finds what was seen."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np
import torch

from descriptors.constellation import Constellations, gather_constellations
from descriptors.descriptellation_lr.likelihood import LearnedLikelihood
from descriptors.descriptellation_lr.network import DescriptellationLR, background_of
from descriptors.descriptellation_lr.rings import Background, Rings
from descriptors.learned.weights import Weights, save_weights
from descriptors.likelihood_index import LikelihoodIndex
from descriptors.registry import make_index, shipped_weights
from descriptors.training.maps import TrainingMap, draw_forest, draw_street

SHIPPED = shipped_weights("descriptellation_lr")


def street(seed: int, radius_m: float = 60.0) -> tuple[TrainingMap, Constellations]:
    drawn = draw_street(rng=np.random.default_rng(seed))
    vocabulary = tuple(map(str, range(drawn.classes)))
    return drawn, gather_constellations(drawn.positions, drawn.labels, vocabulary, radius_m=radius_m)


def test_numpy_and_torch_compute_the_same_likelihood(tmp_path) -> None:
    _, constellations = street(1)
    torch.manual_seed(0)
    network = DescriptellationLR()
    for parameter in network.parameters():
        torch.nn.init.normal_(parameter, -0.3, 0.1)
    tensors = {name: tensor.numpy() for name, tensor in network.state_dict().items()}
    save_weights(tmp_path / "lr.safetensors", Weights(tensors=tensors, architecture=asdict(network.architecture)))
    with torch.no_grad():
        expected = network(constellations, background_of(constellations, network.rings)).flatten(1).numpy()
    found = LearnedLikelihood(tmp_path / "lr.safetensors").describe(constellations)
    np.testing.assert_allclose(found, expected, atol=2e-3)


def test_turned_sensor_changes_nothing() -> None:
    drawn, constellations = street(2)
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    turned = gather_constellations(
        drawn.positions @ turn.T + 50.0, drawn.labels, constellations.vocabulary, radius_m=60.0
    )
    first, second = LearnedLikelihood(SHIPPED), LearnedLikelihood(SHIPPED)
    np.testing.assert_allclose(first.describe(constellations), second.describe(turned), atol=1e-3)


def test_map_grows_with_its_vocabulary() -> None:
    index = LikelihoodIndex(LearnedLikelihood(SHIPPED))
    assert len(index) == 0
    rng = np.random.default_rng(0)
    positions, labels = rng.uniform(0.0, 80.0, (60, 3)), rng.integers(2, size=60)
    index.add(gather_constellations(positions, labels, ("a", "b"), radius_m=60.0))
    more = gather_constellations(positions + np.array([500.0, 0.0, 0.0]), labels + 1, ("a", "b", "c"), radius_m=60.0)
    index.add(more)
    matches = index.search(more, 1, np.ones(120, dtype=np.bool_))
    assert np.mean(matches.entries == 60 + np.arange(60)) > 0.9
    assert (matches.distances >= 0.0).all()


def test_among_many_of_one_class_the_right_one_is_found() -> None:
    """In a forest all rings hold stems; that a place has more of them than another must not decide."""
    hits = []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        forest = draw_forest(rng=rng)
        index = make_index("descriptellation_lr")
        vocabulary = tuple(map(str, range(forest.classes)))
        index.add(gather_constellations(forest.positions, forest.labels, vocabulary, radius_m=index.radius_m))
        middle = forest.positions[rng.integers(len(forest)), :2]
        near = np.flatnonzero(np.hypot(*(forest.positions[:, :2] - middle).T) < 30.0)
        near = near[rng.random(len(near)) < 0.7]
        noisy = forest.positions[near] + rng.normal(0.0, 0.1, (len(near), 3))
        asking = gather_constellations(noisy, forest.labels[near], vocabulary, radius_m=index.radius_m)
        matches = index.search(asking, 5, np.ones(len(index), dtype=np.bool_))
        hits.append(np.count_nonzero(near[matches.queries] == matches.entries) / max(len(near), 1))
    assert np.mean(hits) > 0.5


def test_rings_cover_all_distances_without_gaps() -> None:
    rings = Rings(60.0, 0.25, 0.02)
    assert rings.edges_m[0] == 0.0
    assert rings.edges_m[-1] == 60.0
    assert (np.diff(rings.widths_m) >= -1e-9).all()
    assert rings.of(np.array([0.0, 0.2, 59.99, 60.0, 1e3])).tolist() == [0, 0, *[len(rings) - 1] * 3]


def test_the_background_is_what_an_average_object_has_around_it() -> None:
    rng = np.random.default_rng(0)
    positions = np.column_stack([rng.uniform(-200.0, 200.0, (1600, 2)), np.zeros(1600)])  # 0.01 a square metre
    inner = np.flatnonzero(np.abs(positions[:, :2]).max(axis=1) < 140.0)
    constellations = gather_constellations(positions, np.zeros(1600, np.int64), ("tree",), radius_m=60.0, centres=inner)
    rings = Rings(60.0, 0.25, 0.02)
    background = Background(rings)
    background.add(constellations)
    expected = 2.0 * np.pi * rings.middles_m * 0.01
    np.testing.assert_allclose(background.density(1)[0, 10:-10], expected[10:-10], rtol=0.15)
