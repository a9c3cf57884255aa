"""Histograms over rings: alike for what is alike however it is turned, shifted and listed, and unlike otherwise."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from descriptors.baselines.onion import OnionHistogram
from descriptors.constellation import gather_constellations
from descriptors.descriptor import DESCRIPTOR_NAMES, Descriptor, make_descriptor
from descriptors.errors import DescriptorError
from descriptors.ring_histogram import RingHistogram
from slam.geometry import FloatArray, IntArray, apply, transform_from_xyz_yaw
from tests.descriptors.constellations import VOCABULARY, scattered

both = pytest.mark.parametrize("descriptor", [RingHistogram(), OnionHistogram()], ids=lambda d: d.name)


def describe(
    descriptor: Descriptor, positions: FloatArray, labels: IntArray, vocabulary: tuple[str, ...] = VOCABULARY
) -> NDArray[np.float32]:
    constellations = gather_constellations(positions, labels, vocabulary, radius_m=descriptor.radius_m)
    return descriptor.describe(constellations)


def differences(a: NDArray[np.float32], b: NDArray[np.float32]) -> FloatArray:
    """Distance (B,) of each pair of vectors, relative to the length of the first."""
    return np.asarray(np.linalg.norm(a - b, axis=1) / np.linalg.norm(a, axis=1), dtype=np.float64)


@both
@pytest.mark.parametrize("yaw_rad", [0.3, np.pi, -2.0])
def test_yaw_and_translation_change_nothing(descriptor, yaw_rad):
    positions, labels = scattered(60, seed=1)
    T = transform_from_xyz_yaw(np.array([120.0, -75.0, 4.0]), yaw_rad)
    moved = describe(descriptor, apply(T, positions), labels)
    assert differences(describe(descriptor, positions, labels), moved).max() < 1e-5


@both
def test_the_order_of_the_objects_changes_nothing(descriptor):
    positions, labels = scattered(60, seed=2)
    order = np.random.default_rng(0).permutation(60)
    shuffled = describe(descriptor, positions[order], labels[order])
    assert differences(describe(descriptor, positions, labels)[order], shuffled).max() < 1e-5


@both
def test_a_vocabulary_that_grows_or_is_sorted_otherwise_changes_nothing(descriptor):
    positions, labels = scattered(60, seed=3)
    before = describe(descriptor, positions, labels)
    assert differences(before, describe(descriptor, positions, labels, (*VOCABULARY, "fountain"))).max() < 1e-5
    backwards = describe(descriptor, positions, len(VOCABULARY) - 1 - labels, VOCABULARY[::-1])
    assert differences(before, backwards).max() < 1e-5


@both
def test_classes_and_distances_are_told_apart(descriptor):
    beside = np.array([[0.0, 0.0, 0.0], [8.0, 0.0, 0.0]])
    farther = np.array([[0.0, 0.0, 0.0], [14.0, 0.0, 0.0]])
    first = describe(descriptor, beside, np.array([0, 1]))
    assert differences(first, describe(descriptor, beside, np.array([0, 2])))[0] > 0.5
    assert differences(first, describe(descriptor, farther, np.array([0, 1])))[0] > 0.5


@both
def test_an_unrelated_constellation_is_farther_than_one_with_noise_and_an_object_missing(descriptor):
    positions, labels = scattered(60, seed=5)
    noise = np.random.default_rng(6).normal(scale=0.2, size=positions.shape)
    original = describe(descriptor, positions, labels)
    again = differences(original[:-1], describe(descriptor, (positions + noise)[:-1], labels[:-1]))
    unrelated = differences(original, describe(descriptor, *scattered(60, seed=7)))
    assert np.median(again) < 0.5 * np.median(unrelated)


def test_noise_moves_the_ring_histogram_in_proportion_and_little():
    positions, labels = scattered(60, seed=8)
    noise = np.random.default_rng(9).normal(size=positions.shape)
    original = describe(RingHistogram(), positions, labels)
    by_sigma_m = {
        sigma_m: np.median(differences(original, describe(RingHistogram(), positions + sigma_m * noise, labels)))
        for sigma_m in (0.01, 0.1)
    }
    assert 0.0 < by_sigma_m[0.01] < 0.01
    assert by_sigma_m[0.1] == pytest.approx(10.0 * by_sigma_m[0.01], rel=0.2)


def test_a_step_over_the_border_of_a_shell_moves_the_ring_histogram_less_than_the_onion_histogram():
    labels = np.array([0, 1])
    inside, outside = (np.array([[0.0, 0.0, 0.0], [x, 0.0, 0.0]]) for x in (8.99, 9.01))
    moved = [
        differences(describe(descriptor, inside, labels), describe(descriptor, outside, labels))[0]
        for descriptor in (RingHistogram(), OnionHistogram())
    ]
    assert moved[0] < 0.05
    assert moved[1] > 1.0


@pytest.mark.parametrize("name", DESCRIPTOR_NAMES)
def test_every_descriptor_gives_finite_vectors_of_its_length_for_lonely_objects(name):
    descriptor = make_descriptor(name)
    assert descriptor.name == name
    lonely = describe(descriptor, np.array([[0.0, 0.0, 0.0], [500.0, 0.0, 0.0]]), np.array([0, 1]))
    assert lonely.shape == (2, descriptor.length)
    assert lonely.dtype == np.float32
    assert np.isfinite(lonely).all()


@both
def test_no_constellation_gives_no_vector(descriptor):
    nobody = describe(descriptor, np.zeros((0, 3)), np.zeros(0, dtype=np.int64))
    assert nobody.shape == (0, descriptor.length)


def test_a_descriptor_that_does_not_exist_is_refused_with_the_names_of_those_that_do():
    with pytest.raises(DescriptorError, match=r"'rings'.*ring_histogram"):
        make_descriptor("rings")
