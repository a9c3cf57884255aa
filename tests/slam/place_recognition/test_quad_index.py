"""The index of quads: found again in another frame, with noise, and not when mirrored."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from slam.common.arrays import FloatArray
from slam.common.geometry import apply, transform_from_xyz_yaw
from slam.place_recognition.quad_index import QuadIndex, build_quad_index
from slam.place_recognition.quads import canonical_quads, neighbour_sets, possible_quads

SIGMA_M = 0.2


@pytest.fixture(scope="module")
def forest() -> FloatArray:
    rng = np.random.default_rng(1)
    return np.column_stack([rng.uniform(-300.0, 300.0, (4000, 2)), np.zeros(4000)])


@pytest.fixture(scope="module")
def index(forest: FloatArray) -> QuadIndex:
    return build_quad_index(forest, np.zeros(len(forest), np.int64), sigma_m=SIGMA_M)


def matches_of(index: QuadIndex, forest: FloatArray, seen: FloatArray, label: int = 0) -> set[tuple[int, ...]]:
    """Quads of the query that were found, as rows of query and map."""
    labels = np.full(len(seen), label)
    found = index._match(seen, labels, forest.astype(np.float32), sigma_m=SIGMA_M)
    return {
        (*query, *reference) for query, reference in zip(found.query.tolist(), found.reference.tolist(), strict=True)
    }


def right(rows: np.ndarray, matches: set[tuple[int, ...]]) -> int:
    return sum(rows[list(match[:4])].tolist() == list(match[4:]) for match in matches)


def test_a_view_in_another_frame_finds_its_quads(forest: FloatArray, index: QuadIndex) -> None:
    rows = np.flatnonzero(np.hypot(forest[:, 0] - 50.0, forest[:, 1] + 20.0) < 30.0)
    noise = np.random.default_rng(2).normal(0.0, 0.1, (len(rows), 3))
    seen = apply(transform_from_xyz_yaw(np.array([5.0, 900.0, 0.0]), 2.0), forest[rows]) + noise
    assert right(rows, matches_of(index, forest, seen)) > 20
    assert right(rows, matches_of(index, forest, seen * [1.0, -1.0, 1.0])) <= 2  # four in a row are their own image
    assert matches_of(index, forest, seen, label=1) == set()


def test_the_order_of_corners_does_not_depend_on_the_order_of_rows(forest: FloatArray) -> None:
    plane = forest[:, 0] + 1j * forest[:, 1]
    sets = neighbour_sets(forest[:, :2], np.arange(100), cKDTree(forest[:, :2]))
    straight = canonical_quads(plane, sets)
    shuffled = canonical_quads(plane, sets[:, [2, 0, 3, 1]])
    order = [np.lexsort(quads.vertices.T) for quads in (straight, shuffled)]
    np.testing.assert_array_equal(straight.vertices[order[0]], shuffled.vertices[order[1]])
    assert len(straight) == len(sets)
    assert (straight.lengths[:, 0] >= np.abs(straight.lengths[:, 1:]).max(axis=1) - 1e-9).all()


def test_a_square_has_all_the_orders_that_noise_may_give_it() -> None:
    plane = np.array([0.0, 10.0, 10.0 + 10.0j, 10.0j])
    sets = np.array([[0, 1, 2, 3]])
    assert len(possible_quads(plane, sets, 0.5)) == 8  # two diagonals, both ways, and the others in either order


def test_few_objects_have_no_quads() -> None:
    few = np.array([[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [0.0, 7.0, 0.0]])
    index = build_quad_index(few, np.zeros(3, np.int64), sigma_m=SIGMA_M)
    assert len(index) == 0
    assert len(index._match(few, np.zeros(3, np.int64), few.astype(np.float32), sigma_m=SIGMA_M)) == 0


def test_each_quad_of_the_map_is_in_the_index_once(forest: FloatArray, index: QuadIndex) -> None:
    corners = np.sort(index.vertices, axis=1)
    assert len(np.unique(corners, axis=0)) == len(corners)
    assert index.starts[-1] == len(index)
