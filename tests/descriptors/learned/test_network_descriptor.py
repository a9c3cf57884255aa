"""A trained network as a descriptor: a vector for each constellation, in the order given, whatever else there is."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from descriptors.baselines.pointnet import PointNetArchitecture
from descriptors.baselines.sgnet import SGNetArchitecture
from descriptors.constellation import Constellations, gather_constellations
from descriptors.descriptellation.augmentation import AugmentationRates
from descriptors.descriptellation.dataset import DatasetConfig, make_dataset
from descriptors.descriptellation.network import DescriptellationArchitecture
from descriptors.descriptellation.simulation import MapSimulation
from descriptors.descriptor import Descriptor
from descriptors.errors import DescriptorError, WeightsError
from descriptors.learned.architectures import make_network
from descriptors.learned.inference import BATCH, describe_padded
from descriptors.learned.network_descriptor import LearnedDescriptor
from descriptors.learned.weights import WeightsMetadata, load_weights, save_weights
from descriptors.registry import NETWORKS, SHIPPED, make_descriptor
from descriptors.top_k import top_k_ratio
from tests.descriptors.constellations import VOCABULARY, scattered

pytestmark = pytest.mark.slow

TINY = DescriptellationArchitecture(vocabulary_size=6, layers=2, channels=8, fusion=8, length=16)
SHIPPED_NAMES = [name for name in NETWORKS if (SHIPPED / f"{name}.safetensors").exists()]
TRAINED = SHIPPED / "descriptellation.safetensors"
if_shipped = pytest.mark.skipif(not TRAINED.exists(), reason=f"{TRAINED} is missing; train it with 'dslam train'")


def saved(path: Path, architecture=TINY, radius_m: float = 30.0) -> LearnedDescriptor:
    torch.manual_seed(0)
    save_weights(path, make_network(architecture), WeightsMetadata(training={"dataset": {"radius_m": radius_m}}))
    return LearnedDescriptor(path)


@pytest.fixture(scope="module")
def descriptor(tmp_path_factory) -> LearnedDescriptor:
    return saved(tmp_path_factory.mktemp("weights") / "tiny.safetensors")


@pytest.fixture(scope="module")
def constellations() -> Constellations:
    """More than a batch, of 1 to about 50 objects."""
    positions, labels = scattered(BATCH + 60, seed=1, side_m=150.0)
    positions[:40, :2] *= 0.2
    positions[-5:, 0] += 1000.0 * np.arange(1, 6)
    return gather_constellations(positions, labels, VOCABULARY, radius_m=30.0)


def assert_alike(a: NDArray[np.float32], b: NDArray[np.float32]) -> None:
    np.testing.assert_allclose(a, b, atol=1e-5)


def test_it_is_a_descriptor_with_the_sizes_and_the_radius_of_its_training(tmp_path):
    made: Descriptor = saved(tmp_path / "a.safetensors", radius_m=17.5)
    assert isinstance(made, LearnedDescriptor)
    assert (made.name, made.length, made.radius_m, made.vocabulary_size) == ("descriptellation", 16, 17.5, 6)


@pytest.mark.parametrize("architecture", [PointNetArchitecture(length=24), SGNetArchitecture(length=24)])
def test_a_unit_vector_for_each_constellation(tmp_path, constellations, architecture):
    vectors = saved(tmp_path / "a.safetensors", architecture).describe(constellations)
    assert vectors.shape == (len(constellations), architecture.length)
    assert vectors.dtype == np.float32
    assert np.linalg.norm(vectors, axis=1) == pytest.approx(1.0, abs=1e-5)


def test_each_row_is_that_of_its_constellation_on_its_own(descriptor, constellations):
    sizes = np.diff(constellations.offsets)
    assert len(np.unique(sizes)) > 10
    assert np.any(np.diff(sizes) < 0)  # not sorted by size as they come
    vectors = descriptor.describe(constellations)
    for row in [*range(0, len(constellations), 23), len(constellations) - 1]:
        assert_alike(vectors[[row]], descriptor.describe(constellations[np.array([row])]))
    assert np.linalg.norm(np.diff(vectors[:40], axis=0), axis=1).min() > 1e-4  # others would have been noticed


def test_the_order_of_the_constellations_is_the_order_of_the_rows(descriptor, constellations):
    order = np.random.default_rng(2).permutation(len(constellations))
    assert_alike(descriptor.describe(constellations)[order], descriptor.describe(constellations[order]))


def test_the_order_of_the_objects_changes_nothing(descriptor):
    positions, labels = scattered(60, seed=3)
    order = np.random.default_rng(4).permutation(60)
    described = [
        descriptor.describe(gather_constellations(p, c, VOCABULARY, radius_m=30.0))
        for p, c in ((positions, labels), (positions[order], labels[order]))
    ]
    assert_alike(described[0][order], described[1])


def test_classes_and_places_are_told_apart(descriptor):
    positions, labels = scattered(20, seed=5, side_m=20.0)
    moved, others = positions.copy(), labels.copy()
    moved[3] += 5.0
    others[3] = (labels[3] + 1) % len(VOCABULARY)
    original, elsewhere, other = (
        descriptor.describe(gather_constellations(p, c, VOCABULARY, radius_m=30.0))
        for p, c in ((positions, labels), (moved, labels), (positions, others))
    )
    assert np.abs(original - elsewhere).max() > 1e-3
    assert np.abs(original - other).max() > 1e-3


def test_the_same_constellations_give_the_same_bits_whatever_the_threads(descriptor, constellations):
    expected = descriptor.describe(constellations)
    threads = torch.get_num_threads()
    try:
        torch.set_num_threads(2)
        assert np.array_equal(descriptor.describe(constellations), expected)
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(threads)


def with_label(label: int, size: int = 64) -> Iterator[Constellations]:
    """Constellations with that label once at a neighbour and once at a centre."""
    vocabulary = [f"class {number}" for number in range(size)]
    for labels in ([0, label], [label, 0]):
        around = gather_constellations(np.zeros((2, 3)), np.array(labels), vocabulary, radius_m=5.0)
        yield around[np.array([0])]


def test_a_class_that_the_embedding_has_no_row_for_is_refused_with_both_numbers(descriptor):
    for constellations in with_label(6):
        with pytest.raises(DescriptorError, match=r"label 6 .*6 classes, 0 to 5.*vocabulary_size"):
            descriptor.describe(constellations)
    for constellations in with_label(5):
        assert descriptor.describe(constellations).shape == (1, 16)


def test_no_constellation_gives_no_vector(descriptor):
    nobody = gather_constellations(np.zeros((0, 3)), np.zeros(0, np.int64), VOCABULARY, radius_m=30.0)
    vectors = descriptor.describe(nobody)
    assert vectors.shape == (0, 16)
    assert vectors.dtype == np.float32


def test_an_object_on_its_own_has_a_vector_that_depends_on_its_class(descriptor):
    labels = np.array([0, 1, 0])
    lonely = gather_constellations(np.eye(3) * 1000.0, labels, VOCABULARY, radius_m=30.0)
    vectors = descriptor.describe(lonely)
    assert np.isfinite(vectors).all()
    assert_alike(vectors[0], vectors[2])
    assert np.abs(vectors[0] - vectors[1]).max() > 1e-4


def test_a_file_that_is_missing_or_damaged_is_refused(tmp_path):
    with pytest.raises(WeightsError, match=r"none\.safetensors: no such file"):
        LearnedDescriptor(tmp_path / "none.safetensors")
    (tmp_path / "net.safetensors").write_bytes(b"no weights")
    with pytest.raises(WeightsError, match=r"net\.safetensors"):
        LearnedDescriptor(tmp_path / "net.safetensors")


def test_weights_that_do_not_tell_their_radius_are_refused(tmp_path):
    torch.manual_seed(0)
    save_weights(tmp_path / "net.safetensors", make_network(TINY), WeightsMetadata(training={"epochs": 3}))
    with pytest.raises(WeightsError, match=r"net\.safetensors.*radius_m"):
        LearnedDescriptor(tmp_path / "net.safetensors")


@pytest.mark.skipif(not SHIPPED_NAMES, reason=f"no weights in {SHIPPED}")
@pytest.mark.parametrize("name", SHIPPED_NAMES)
def test_the_weights_that_ship_describe(constellations, name):
    descriptor = make_descriptor(name)
    assert descriptor.name == name
    vectors = descriptor.describe(constellations)
    assert vectors.shape == (len(constellations), descriptor.length)  # type: ignore[attr-defined]
    assert np.isfinite(vectors).all()


@if_shipped
def test_the_network_that_ships_finds_as_many_of_its_validation_views_as_the_paper():
    metadata = LearnedDescriptor(TRAINED).metadata
    assert metadata.metrics["validation_top_k"] >= 0.981
    assert metadata.training["architecture"]["name"] == "descriptellation"
    assert metadata.training["dataset"]["anchors"] == 1000
    assert metadata.code_version


@if_shipped
def test_the_network_that_ships_finds_views_of_maps_that_nobody_chose_it_by():
    dataset = make_dataset(MapSimulation(), AugmentationRates(), DatasetConfig(anchors=100), seed=12345)
    network, _ = load_weights(TRAINED)
    vectors = describe_padded(network, dataset.constellations, torch.device("cpu"))
    assert top_k_ratio(vectors, dataset.anchors, 5) >= 0.981
