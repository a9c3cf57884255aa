"""Descriptors by networks: one vector for each constellation, whatever else is described with it."""

from collections.abc import Iterator
from dataclasses import asdict

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from descriptors.constellation import Constellations, gather_constellations
from descriptors.descriptellation.network import DescriptellationArchitecture
from descriptors.errors import DescriptorError
from descriptors.learned.networks import BATCH, LearnedDescriptor, load_network, make_network, pad_constellations
from descriptors.learned.weights import Weights, read_weights, save_weights
from descriptors.registry import make_index, shipped_weights
from descriptors.training.contrast import ContrastTraining
from descriptors.training.trainer import Recipe
from tests.descriptors.constellations import found_again, gathered, scattered

pytestmark = pytest.mark.slow

TINY = DescriptellationArchitecture(vocabulary_size=6, layers=2, channels=8, fusion=8, length=16, radius_m=17.5)


@pytest.fixture(scope="module")
def descriptor(tmp_path_factory) -> LearnedDescriptor:
    path = tmp_path_factory.mktemp("weights") / "tiny.safetensors"
    torch.manual_seed(0)
    tensors = {name: tensor.numpy() for name, tensor in make_network(TINY).state_dict().items()}
    save_weights(path, Weights(tensors=tensors, architecture=asdict(TINY)))
    return LearnedDescriptor(path)


@pytest.fixture(scope="module")
def constellations() -> Constellations:
    """More than a batch, of 1 to about 50 objects."""
    positions, labels = scattered(BATCH + 60, seed=1, side_m=150.0)
    positions[:40, :2] *= 0.2
    positions[-5:, 0] += 1000.0 * np.arange(1, 6)
    return gathered(positions, labels, 30.0)


def assert_alike(a: NDArray[np.float32], b: NDArray[np.float32]) -> None:
    np.testing.assert_allclose(a, b, atol=1e-5)


def test_each_row_is_that_of_its_constellation_on_its_own(descriptor, constellations):
    vectors = descriptor.describe(constellations)
    assert (vectors.dtype, descriptor.radius_m) == (np.float32, 17.5)
    for row in [*range(0, len(constellations), 23), len(constellations) - 1]:
        assert_alike(vectors[[row]], descriptor.describe(constellations[np.array([row])]))
    assert np.linalg.norm(np.diff(vectors[:40], axis=0), axis=1).min() > 1e-4  # others would have been noticed


def test_same_constellations_give_the_same_bits_for_any_number_of_threads(descriptor, constellations):
    expected = descriptor.describe(constellations)
    threads = torch.get_num_threads()
    try:
        torch.set_num_threads(2)
        assert np.array_equal(descriptor.describe(constellations), expected)
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(threads)


def with_label(label: int) -> Iterator[Constellations]:
    """Constellations with that label once at a neighbour and once at a centre."""
    vocabulary = [f"class {number}" for number in range(64)]
    for labels in ([0, label], [label, 0]):
        around = gather_constellations(np.zeros((2, 3)), np.array(labels), vocabulary, radius_m=5.0)
        yield around[np.array([0])]


def test_class_without_a_row_of_the_embedding_is_refused_with_both_numbers(descriptor):
    for constellations in with_label(6):
        with pytest.raises(DescriptorError, match=r"labels 0 to 6 .*6 classes.*vocabulary_size"):
            descriptor.describe(constellations)
    for constellations in with_label(5):
        assert descriptor.describe(constellations).shape == (1, 16)


def test_candidates_of_the_paper_s_network_are_of_any_class():
    matches = found_again(make_index("descriptellation"), *scattered(30, seed=2), k=30)
    assert len(matches.queries) == 900


def test_centre_comes_first_then_the_neighbours_then_nothing(constellations):
    positions, labels, present = (each.numpy() for each in pad_constellations(constellations))
    counts = np.diff(constellations.offsets)
    assert positions.shape == (len(constellations), counts.max() + 1, 3)
    for row in (0, 50, len(constellations) - 1):
        own = slice(constellations.offsets[row], constellations.offsets[row + 1])
        room = counts.max() - counts[row]
        expected = [np.zeros(3), *constellations.positions[own], *np.zeros((room, 3))]
        np.testing.assert_allclose(positions[row], expected, atol=1e-5)
        np.testing.assert_array_equal(
            labels[row], [constellations.centre_labels[row], *constellations.labels[own], *[0] * room]
        )
        np.testing.assert_array_equal(present[row], [True] * (counts[row] + 1) + [False] * room)


def test_shipped_network_finds_views_of_maps_that_it_was_not_trained_on():
    path = shipped_weights("descriptellation")
    network = load_network(path)
    assert read_weights(path).metrics["validation_top_k"] >= 0.981
    recipe = Recipe(ContrastTraining(architecture=DescriptellationArchitecture()))
    recipe.network.load_state_dict(network.state_dict())
    trained, untrained = recipe.validate(), Recipe(recipe.config).validate()
    assert trained["validation_top_5"] > untrained["validation_top_5"] + 0.2
