"""Padding keeps every object where it was, puts the centre first, and shows what is no object."""

from __future__ import annotations

import numpy as np
import pytest

from descriptors.constellation import Constellations, gather_constellations
from descriptors.learned.padded import PaddedConstellations, pad_constellations
from tests.descriptors.constellations import VOCABULARY, constellation, scattered


@pytest.fixture(scope="module")
def constellations() -> Constellations:
    """Of 1 to about 20 objects, the largest ones in the middle."""
    positions, labels = scattered(40, seed=1)
    positions[[0, 1, 39], 0] += [1000.0, 2000.0, 3000.0]
    return gather_constellations(positions, labels, VOCABULARY, radius_m=20.0)


def assert_equal(a: PaddedConstellations, b: PaddedConstellations) -> None:
    np.testing.assert_array_equal(a.positions, b.positions)
    np.testing.assert_array_equal(a.labels, b.labels)
    np.testing.assert_array_equal(a.present, b.present)


def test_the_centre_comes_first_then_the_neighbours_then_nothing(constellations):
    padded = pad_constellations(constellations)
    counts = np.diff(constellations.offsets)
    assert len(padded) == 40
    assert counts.min() == 0
    assert padded.labels.shape == padded.present.shape == (40, counts.max() + 1)
    assert padded.positions.shape == (40, counts.max() + 1, 3)
    for row, count in enumerate(counts.tolist()):
        own = slice(constellations.offsets[row], constellations.offsets[row + 1])
        expected = [np.zeros(3), *constellations.positions[own], *np.zeros((counts.max() - count, 3))]
        np.testing.assert_allclose(padded.positions[row], expected, atol=1e-5)
        labels = [constellations.centre_labels[row], *constellations.labels[own], *[0] * (counts.max() - count)]
        np.testing.assert_array_equal(padded.labels[row], labels)
        np.testing.assert_array_equal(padded.present[row], [True] * (count + 1) + [False] * (counts.max() - count))


def test_arrays_have_the_types_that_networks_take(constellations):
    padded = pad_constellations(constellations)
    types = padded.positions.dtype, padded.labels.dtype, padded.present.dtype
    assert types == (np.float32, np.int64, np.bool_)


@pytest.mark.parametrize("rows", [[7], [0, 39, 1], [12, 3, 3, 20], []])
def test_chosen_ones_are_padded_as_if_they_were_all(constellations, rows):
    chosen = np.array(rows, dtype=np.int64)
    assert_equal(pad_constellations(constellations)[chosen], pad_constellations(constellations[chosen]))


@pytest.mark.parametrize("rows", [slice(5, 12), slice(0, 2), slice(3, 3), slice(None)])
def test_a_slice_is_padded_as_if_it_were_all(constellations, rows):
    assert_equal(
        pad_constellations(constellations)[rows],
        pad_constellations(constellations[np.arange(len(constellations))[rows]]),
    )


def test_an_object_alone_needs_room_for_itself_only():
    padded = pad_constellations(constellation([], centre_label=3))
    assert_equal(padded, PaddedConstellations(np.zeros((1, 1, 3), np.float32), np.array([[3]]), np.array([[True]])))


def test_no_constellation_gives_no_row():
    nobody = gather_constellations(np.zeros((0, 3)), np.zeros(0, dtype=np.int64), VOCABULARY, radius_m=20.0)
    padded = pad_constellations(nobody)
    assert len(padded) == 0
    assert padded.positions.shape == (0, 1, 3)


def test_a_neighbour_at_the_place_of_the_centre_is_present():
    padded = pad_constellations(constellation([(2, 0.0, 0.0)], centre_label=1))
    np.testing.assert_array_equal(padded.present, [[True, True]])
    np.testing.assert_array_equal(padded.labels, [[1, 2]])
    np.testing.assert_array_equal(padded.positions, np.zeros((1, 2, 3)))
