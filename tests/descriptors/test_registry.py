"""Every name stands for an index that finds again what it holds, whatever is in it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import descriptors
from descriptors.constellation import gather_constellations
from descriptors.errors import DescriptorError
from descriptors.index import ConstellationIndex, Matches, VectorIndex
from descriptors.likelihood_index import LikelihoodIndex
from descriptors.random_vector import RandomVector
from descriptors.registry import DESCRIPTOR_NAMES, LEARNED, NETWORKS, PAPER, make_descriptor, make_index
from slam.common.arrays import FloatArray, IntArray
from tests.descriptors.constellations import VOCABULARY, describe, scattered

WEIGHTS = Path(descriptors.__file__).parent / "weights"
# Of these, the vectors of unlike objects may be as near as those of like ones.
VAGUE = ("onion", "gosmatch_graph", "random")


def _parameter(name: str) -> object:
    missing = name in LEARNED and not (WEIGHTS / f"{name}.safetensors").exists()
    reason = f"{name} has no weights in {WEIGHTS}; train it with 'dslam train'"
    return pytest.param(name, marks=pytest.mark.skipif(missing, reason=reason))


every_name = pytest.mark.parametrize("name", [_parameter(name) for name in DESCRIPTOR_NAMES])


def added(index: ConstellationIndex, positions: FloatArray, labels: IntArray) -> None:
    index.add(gather_constellations(positions, labels, VOCABULARY, radius_m=index.radius_m))


def searched(index: ConstellationIndex, positions: FloatArray, labels: IntArray, k: int) -> Matches:
    constellations = gather_constellations(positions, labels, VOCABULARY, radius_m=index.radius_m)
    return index.search(constellations, k, np.ones(len(index), dtype=bool))


@every_name
def test_every_index_finds_the_objects_of_a_scattered_map_again(name):
    positions, labels = scattered(60, seed=1)
    index = make_index(name)
    added(index, positions, labels)
    assert len(index) == 60
    matches = searched(index, positions, labels, 1)
    np.testing.assert_array_equal(matches.queries, np.arange(60))
    np.testing.assert_array_equal(labels[matches.entries], labels)
    assert np.isfinite(matches.distances).all()
    if name not in VAGUE:
        assert np.mean(matches.entries == np.arange(60)) > 0.9


@every_name
def test_every_descriptor_has_its_name_and_finite_vectors_of_one_length(name):
    descriptor = make_descriptor(name)
    assert descriptor.name == name
    positions, labels = scattered(30, seed=2)
    positions[:2, 0] += [1000.0, 2000.0]
    vectors, lonely = describe(descriptor, positions, labels), describe(descriptor, positions[:1], labels[:1])
    nobody = describe(descriptor, positions[:0], labels[:0])
    assert len(vectors) == 30
    assert vectors.shape[1:] == lonely.shape[1:] == nobody.shape[1:]
    assert np.isfinite(vectors).all()
    assert vectors.dtype == lonely.dtype == nobody.dtype == np.float32


@every_name
def test_every_index_takes_two_objects_at_one_place(name):
    positions, labels = scattered(20, seed=3)
    # Of the doubles, some have the class of the object that they coincide with and some do not.
    positions, labels = np.concatenate([positions, positions]), np.concatenate([labels, labels])
    labels[:10] = 0
    descriptor, index = make_descriptor(name), make_index(name)
    assert np.isfinite(describe(descriptor, positions, labels)).all()
    added(index, positions, labels)
    matches = searched(index, positions, labels, 5)
    np.testing.assert_array_equal(np.unique(matches.queries), np.arange(40))
    assert np.isfinite(matches.distances).all()
    assert (matches.distances >= 0.0).all()


@every_name
def test_every_index_takes_a_place_where_all_objects_are_one_spot(name):
    index = make_index(name)
    added(index, np.full((5, 3), 7.0), np.array([0, 0, 1, 2, 2]))
    matches = searched(index, np.full((5, 3), 7.0), np.array([0, 0, 1, 2, 2]), 5)
    if name != PAPER:  # which compares objects of all classes
        np.testing.assert_array_equal(matches.queries, [0, 0, 1, 1, 2, 3, 3, 4, 4])
    assert np.isfinite(matches.distances).all()


@every_name
def test_every_index_may_be_searched_while_it_is_empty(name):
    assert len(searched(make_index(name), *scattered(5, seed=4), 3).queries) == 0


def test_only_the_two_likelihoods_are_looked_up_by_likelihood():
    names = [name for name in DESCRIPTOR_NAMES if name not in NETWORKS]
    likelihoods = [name for name in names if isinstance(make_index(name), LikelihoodIndex)]
    assert likelihoods == ["ring_likelihood", "descriptellation_lr"]


class Own:
    """A descriptor of a user: how many neighbours there are."""

    name = "own"
    radius_m = 20.0

    def describe(self, constellations):
        return np.diff(constellations.offsets)[:, None].astype(np.float32)


def test_a_class_of_one_s_own_is_imported_and_asked():
    index = make_index("tests.descriptors.test_registry:Own")
    assert index.radius_m == 20.0
    positions, labels = scattered(30, seed=3)
    added(index, positions, labels)
    assert len(searched(index, positions, labels, 1).queries) == 30


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("no_such_module:Own", "ModuleNotFoundError"),
        ("tests.descriptors.test_registry:Other", "AttributeError"),
        ("builtins:dict", "lacks name, radius_m, describe"),
        ("no/such.safetensors", "no such file"),
    ],
)
def test_what_is_no_descriptor_is_refused_with_the_reason(name, told):
    with pytest.raises(DescriptorError, match=told):
        make_index(name)


def test_the_paper_s_network_is_compared_with_all_classes():
    """K nearest over the whole map in L2: no class filter."""
    network, own_classes = VectorIndex(RandomVector(), of_own_class=False), VectorIndex(RandomVector())
    positions, labels = scattered(30, seed=3)
    for index in (network, own_classes):
        added(index, positions, labels)
    assert len(searched(network, positions, labels, 30).queries) == 30 * 30
    found = searched(own_classes, positions, labels, 30)
    np.testing.assert_array_equal(labels[found.queries], labels[found.entries])


def test_no_name_is_there_twice():
    assert len(set(DESCRIPTOR_NAMES)) == len(DESCRIPTOR_NAMES)
    assert set(LEARNED) < set(DESCRIPTOR_NAMES)


@pytest.mark.parametrize("make", [make_descriptor, make_index])
def test_a_descriptor_that_does_not_exist_is_refused_with_the_names_of_those_that_do(make):
    with pytest.raises(DescriptorError) as refusal:
        make("rings")
    assert "'rings'" in str(refusal.value)
    assert all(name in str(refusal.value) for name in DESCRIPTOR_NAMES)


def test_former_name_is_refused_with_the_present_one():
    with pytest.raises(DescriptorError, match=r"'descriptellation_paper'.*'descriptellation'"):
        make_index("descriptellation_paper")


def test_random_vectors_are_other_ones_in_each_call_and_the_same_in_each_run():
    positions, labels = scattered(10, seed=5)
    first, second = make_descriptor("random"), make_descriptor("random")
    vectors = [describe(first, positions, labels) for _ in range(2)]
    assert np.abs(vectors[0] - vectors[1]).min() > 0.0
    np.testing.assert_array_equal([describe(second, positions, labels) for _ in range(2)], vectors)


def test_handcrafted_descriptors_do_without_torch():
    """It takes seconds to load, which no command should wait for that uses no network."""
    code = (
        "import sys, descriptors.registry as registry\n"
        "[registry.make_index(name) for name in registry.DESCRIPTOR_NAMES if name not in registry.NETWORKS]\n"
        "assert 'descriptors.likelihood_index' in sys.modules\n"
        "assert 'torch' not in sys.modules, 'torch was imported'\n"
    )
    finished = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert finished.returncode == 0, finished.stderr
