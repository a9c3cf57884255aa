"""Blocks of the inverse, against the dense inverse."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import sparse

from slam.backend.covariance.selected_inverse import diagonal_blocks_of_inverse


def information(rng, *, blocks: int, size: int, rows: int, density: float) -> sparse.csc_array:
    """J^T J of a sparse Jacobian, each block coupled in itself."""
    links = sparse.random_array((rows, blocks * size), density=density, rng=rng, format="csr")
    own = sparse.block_diag([rng.normal(size=(size + 1, size)) for _ in range(blocks)], format="csr")
    jacobian = sparse.vstack([links, own])
    return sparse.csc_array(jacobian.T @ jacobian)


@pytest.mark.parametrize("density", [0.0, 0.005, 0.05])
@pytest.mark.parametrize("size", [1, 3, 6])
def test_all_entries_within_an_owner_are_those_of_the_inverse(size, density):
    rng = np.random.default_rng(size)
    matrix = information(rng, blocks=40, size=size, rows=150, density=density)
    owners = np.repeat(np.arange(40), size)
    rows, columns, values = diagonal_blocks_of_inverse(matrix, owners)
    np.testing.assert_allclose(values, np.linalg.inv(matrix.toarray())[rows, columns], rtol=1e-9, atol=1e-12)
    assert len(rows) == 40 * size * (size + 1) // 2
    np.testing.assert_array_equal(owners[rows], owners[columns])


def test_entries_that_cancel_are_put_back():
    # Eliminating 0 takes away just the link of 1 and 2.
    dense = np.array([[1.0, 0.5, 0.5, 0.0], [0.5, 2.0, 0.25, 0.3], [0.5, 0.25, 2.0, 0.0], [0.0, 0.3, 0.0, 1.0]])
    rows, columns, values = diagonal_blocks_of_inverse(sparse.csc_array(dense), np.zeros(4, dtype=np.int64))
    np.testing.assert_allclose(values, np.linalg.inv(dense)[rows, columns], rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("matrix", [np.diag([1.0, -1.0]), np.array([[1.0, 2.0], [2.0, 1.0]]), np.zeros((2, 2))])
def test_a_matrix_without_an_inverse_that_is_a_covariance_is_refused(matrix):
    with pytest.raises(np.linalg.LinAlgError):
        diagonal_blocks_of_inverse(sparse.csc_array(matrix), np.array([0, 1]))


def test_rows_of_one_owner_need_not_be_coupled():
    dense = np.diag(np.arange(1.0, 7.0))
    dense[0, 5] = dense[5, 0] = 0.3
    owners = np.array([0, 0, 0, 1, 1, 1])
    rows, columns, values = diagonal_blocks_of_inverse(sparse.csc_array(dense), owners)
    assert len(rows) == 6
    np.testing.assert_allclose(values, np.linalg.inv(dense)[rows, columns], rtol=1e-12, atol=1e-15)
    left_out = np.linalg.inv(dense) * (owners[:, None] == owners)
    left_out[rows, columns] = left_out[columns, rows] = 0.0
    np.testing.assert_allclose(left_out, 0.0, atol=1e-15)


def test_parts_that_nothing_couples_are_inverted_apart():
    """Poses of a drive over flat ground: plane and height are two chains, each of which stays narrow."""
    count = 200
    chain = np.diag(np.full(count, 2.1)) - np.diag(np.ones(count - 1), 1) - np.diag(np.ones(count - 1), -1)
    matrix = np.kron(chain, np.diag([1.0, 3.0]))
    rows, columns, values = diagonal_blocks_of_inverse(sparse.csc_array(matrix), np.repeat(np.arange(count), 2))
    assert (rows == columns).all()
    assert len(rows) == 2 * count
    np.testing.assert_allclose(values, np.linalg.inv(matrix)[rows, columns], rtol=1e-9)
