"""Pairs of objects and what is around them."""

import numpy as np
from scipy.spatial import cKDTree

from descriptors.descriptellation_lr.pairs import (
    MIN_LENGTH,
    DescriptellationLRArchitecture,
    Pairs,
    cells_of,
    find_ends,
    gather_pairs,
    spacing_m,
)

SIZES = DescriptellationLRArchitecture()


def pairs_of(positions: np.ndarray, labels: np.ndarray, ends: np.ndarray) -> Pairs:
    return gather_pairs(positions, labels, ends, cKDTree(positions), SIZES)


def test_spacing_is_the_median_distance_to_the_nearest_object_elsewhere() -> None:
    line = np.column_stack([[0.0, 1.0, 3.0, 6.0, 6.0], np.zeros(5)])
    assert spacing_m(line) == 1.5  # 1, 1, 2, 3
    assert spacing_m(line[:1]) == 1.0
    assert spacing_m(line[3:]) == 1.0


def test_each_pair_is_found_once_with_the_lower_class_first() -> None:
    positions = np.array([[0.0, 0.0], [1.0, 0.0], [2.5, 0.0], [1.0, MIN_LENGTH / 2.0]])
    labels = np.array([1, 0, 0, 0])
    ends = find_ends(positions, labels, cKDTree(positions), 2)
    assert sorted(ends.tolist()) == [[1, 0], [1, 2], [2, 3], [3, 0]]  # 1 and 3 are too near each other
    both = find_ends(positions, labels, cKDTree(positions), 2, both_ways=True)
    assert sorted(both.tolist()) == [[1, 0], [1, 2], [2, 1], [2, 3], [3, 0], [3, 2]]
    assert find_ends(positions, labels, cKDTree(positions), 2, centres=np.array([2])).tolist() == [[1, 2], [2, 3]]
    assert find_ends(positions[:1], labels[:1], cKDTree(positions[:1]), 2).shape == (0, 2)


def test_neighbours_are_in_the_frame_of_the_pair() -> None:
    positions = np.array([[0.0, 0.0], [2.0, 0.0], [1.0, 1.5], [3.0, 0.0], [9.0, 9.0]])
    pairs = pairs_of(positions, np.zeros(5, int), np.array([[0, 1], [1, 0]]))
    assert pairs.lengths.tolist() == [2.0, 2.0]
    assert pairs.counts.tolist() == [2, 2]  # the last object is beyond the outer ring
    order = np.lexsort((pairs.radii, pairs.owners))
    np.testing.assert_allclose(pairs.radii[order], [1.5, 2.0, 1.5, 2.0])
    np.testing.assert_allclose(np.exp(1j * pairs.angles[order]), [1j, 1.0, -1j, -1.0], atol=1e-12)


def test_cells_do_not_change_with_the_frame_but_with_the_class_of_a_neighbour() -> None:
    rng = np.random.default_rng(0)
    positions, labels = rng.uniform(0.0, 6.0, (30, 2)), rng.integers(3, size=30)
    ends = find_ends(positions, labels, cKDTree(positions), 3)
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    moved = positions @ turn.T + [100.0, -40.0]
    before, after = (cells_of(pairs_of(each, labels, ends), SIZES) for each in (positions, moved))
    np.testing.assert_array_equal(np.sort(before), np.sort(after))
    others = labels.copy()
    others[~np.isin(np.arange(30), ends[0])] += 3
    assert set(cells_of(pairs_of(positions, others, ends[:1]), SIZES)) != set(
        cells_of(pairs_of(positions, labels, ends[:1]), SIZES)
    )


def test_neighbours_inside_the_inner_ring_have_no_cell() -> None:
    positions = np.array([[0.0, 0.0], [2.0, 0.0], [1.0, 0.5 * SIZES.inner], [1.0, 1.01 * SIZES.inner]])
    cells = cells_of(pairs_of(positions, np.zeros(4, int), np.array([[0, 1]])), SIZES)
    assert np.count_nonzero(cells < 0) == 1
    assert 0 <= cells.max() < SIZES.sectors  # the first ring
