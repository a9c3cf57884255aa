"""Constellations: whoever is within the horizontal radius, relative to the centre, and nobody else."""

import numpy as np
import pytest

from descriptors.constellation import Constellations
from descriptors.errors import DescriptorError
from tests.descriptors.constellations import VOCABULARY, gathered, scattered

RADIUS_M = 15.0


def neighbours_of(constellations: Constellations, i: int) -> list[tuple[float, ...]]:
    """Label and relative position of each neighbour of the i-th centre, in a fixed order."""
    own = slice(constellations.offsets[i], constellations.offsets[i + 1])
    rows = np.column_stack([constellations.labels[own], constellations.positions[own]])
    return sorted(tuple(row) for row in rows.tolist())


def test_neighbours_are_those_that_brute_force_finds():
    positions, labels = scattered(80, seed=0)
    found = gathered(positions, labels, RADIUS_M)
    assert len(found) == 80
    assert found.vocabulary == VOCABULARY
    np.testing.assert_array_equal(found.centre_labels, labels)
    for centre in range(80):
        expected = [
            (float(labels[other]), *(positions[other] - positions[centre]).tolist())
            for other in range(80)
            if other != centre and np.hypot(*(positions[other] - positions[centre])[:2]) <= RADIUS_M
        ]
        assert neighbours_of(found, centre) == sorted(expected)
        assert np.count_nonzero(found.owners == centre) == len(expected)


@pytest.mark.parametrize(("count", "centres"), [(0, None), (5, np.zeros(0, int)), (1, None)])
def test_no_object_no_centre_and_one_object_alone(count, centres):
    positions, labels = scattered(count, seed=0)
    found = gathered(positions, labels, RADIUS_M, centres)
    assert len(found) == (count if centres is None else 0)
    assert found.positions.shape == (0, 3)
    np.testing.assert_array_equal(found.offsets, np.zeros(len(found) + 1))


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_positions_that_are_not_finite_are_refused(bad):
    positions, labels = scattered(5, seed=0)
    positions[3, 2] = bad
    with pytest.raises(DescriptorError, match="object 3"):
        gathered(positions, labels, RADIUS_M)


@pytest.mark.parametrize("rows", [[40, 2, 17], [5, 5, 0], []])
def test_chosen_centres_come_in_that_order_with_their_neighbours(rows):
    positions, labels = scattered(50, seed=6)
    positions[0, 0] += 1000.0  # without neighbours
    everything = gathered(positions, labels, RADIUS_M)
    numbers = np.array(rows, int)
    for chosen in (everything[numbers], gathered(positions, labels, RADIUS_M, numbers)):
        assert chosen.vocabulary == VOCABULARY
        assert chosen.offsets.dtype == chosen.labels.dtype == np.int64
        np.testing.assert_array_equal(chosen.centre_labels, labels[numbers])
        assert len(chosen) == len(rows)
        for i, row in enumerate(rows):
            assert neighbours_of(chosen, i) == neighbours_of(everything, row)
        assert len(chosen.positions) == len(chosen.owners) == chosen.offsets[-1]
