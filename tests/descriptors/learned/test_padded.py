"""Padding keeps every object where it was, puts the centre first, and shows where no object is."""

from __future__ import annotations

import numpy as np
import pytest

from descriptors.constellation import Constellations, gather_constellations
from descriptors.learned.padded import PaddedConstellations, pad_constellations
from tests.descriptors.constellations import VOCABULARY, scattered


@pytest.fixture(scope="module")
def constellations() -> Constellations:
    """Of 1 to about 20 objects, the largest ones in the middle, and one at the place of another."""
    positions, labels = scattered(40, seed=1)
    positions[[0, 1, 39], 0] += [1000.0, 2000.0, 3000.0]
    positions[7] = positions[8]
    return gather_constellations(positions, labels, VOCABULARY, radius_m=20.0)


def assert_equal(a: PaddedConstellations, b: PaddedConstellations) -> None:
    np.testing.assert_array_equal(a.positions, b.positions)
    np.testing.assert_array_equal(a.labels, b.labels)
    np.testing.assert_array_equal(a.present, b.present)


def test_centre_comes_first_then_the_neighbours_then_nothing(constellations):
    padded = pad_constellations(constellations)
    counts = np.diff(constellations.offsets)
    assert counts.min() == 0
    assert padded.positions.shape == (40, counts.max() + 1, 3)
    assert (padded.positions.dtype, padded.labels.dtype, padded.present.dtype) == (np.float32, np.int64, np.bool_)
    for row, count in enumerate(counts.tolist()):
        own = slice(constellations.offsets[row], constellations.offsets[row + 1])
        room = counts.max() - count
        expected = [np.zeros(3), *constellations.positions[own], *np.zeros((room, 3))]
        np.testing.assert_allclose(padded.positions[row], expected, atol=1e-5)
        labels = [constellations.centre_labels[row], *constellations.labels[own], *[0] * room]
        np.testing.assert_array_equal(padded.labels[row], labels)
        np.testing.assert_array_equal(padded.present[row], [True] * (count + 1) + [False] * room)


@pytest.mark.parametrize("rows", [[7], [0, 39, 1], [12, 3, 3, 20], []])
def test_some_are_padded_as_if_they_were_all(constellations, rows):
    chosen = np.array(rows, dtype=np.int64)
    assert_equal(pad_constellations(constellations)[chosen], pad_constellations(constellations[chosen]))
