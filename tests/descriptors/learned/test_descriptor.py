"""Descriptors by networks: one vector for each constellation, whatever else is described with it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from descriptors.constellation import Constellations, gather_constellations
from descriptors.descriptellation.network import DescriptellationArchitecture
from descriptors.errors import DescriptorError, WeightsError
from descriptors.learned.descriptor import LearnedDescriptor
from descriptors.learned.networks import BATCH, describe_padded, load_network, make_network
from descriptors.learned.weights import Weights, save_weights
from descriptors.registry import shipped_weights
from descriptors.training.augmentation import AugmentationRates
from descriptors.training.dataset import DatasetConfig, make_dataset
from descriptors.training.simulation import MapSimulation
from descriptors.training.top_k import top_k_ratio
from tests.descriptors.constellations import VOCABULARY, scattered

pytestmark = pytest.mark.slow

TINY = DescriptellationArchitecture(vocabulary_size=6, layers=2, channels=8, fusion=8, length=16)


def saved(path: Path, training: dict[str, object]) -> LearnedDescriptor:
    torch.manual_seed(0)
    tensors = {name: tensor.numpy() for name, tensor in make_network(TINY).state_dict().items()}
    save_weights(path, Weights(tensors, asdict(TINY), training))
    return LearnedDescriptor(path)


@pytest.fixture(scope="module")
def descriptor(tmp_path_factory) -> LearnedDescriptor:
    return saved(tmp_path_factory.mktemp("weights") / "tiny.safetensors", {"dataset": {"radius_m": 17.5}})


@pytest.fixture(scope="module")
def constellations() -> Constellations:
    """More than a batch, of 1 to about 50 objects."""
    positions, labels = scattered(BATCH + 60, seed=1, side_m=150.0)
    positions[:40, :2] *= 0.2
    positions[-5:, 0] += 1000.0 * np.arange(1, 6)
    return gather_constellations(positions, labels, VOCABULARY, radius_m=30.0)


def assert_alike(a: NDArray[np.float32], b: NDArray[np.float32]) -> None:
    np.testing.assert_allclose(a, b, atol=1e-5)


def test_each_row_is_that_of_its_constellation_on_its_own(descriptor, constellations):
    vectors = descriptor.describe(constellations)
    assert vectors.dtype == np.float32
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


def test_weights_without_their_radius_are_refused(tmp_path):
    with pytest.raises(WeightsError, match=r"net\.safetensors.*radius_m"):
        saved(tmp_path / "net.safetensors", {"epochs": 3})


def test_shipped_network_finds_as_many_views_of_other_maps_as_the_paper():
    network, weights = load_network(shipped_weights("descriptellation"))
    assert weights.metrics["validation_top_k"] >= 0.981
    assert weights.training["dataset"]["anchors"] == 1000
    dataset = make_dataset(MapSimulation(), AugmentationRates(), DatasetConfig(anchors=100), seed=12345)
    vectors = describe_padded(network, dataset.constellations, torch.device("cpu"))
    assert top_k_ratio(vectors, dataset.anchors, 5) >= 0.981
