"""Blocks on the diagonal of the inverse of a sparse symmetric matrix, without the rest of the inverse."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import SuperLU, splu

from slam.common.arrays import FloatArray, IntArray


def diagonal_blocks_of_inverse(matrix: sparse.csc_array, owners: IntArray) -> tuple[IntArray, IntArray, FloatArray]:
    """Entries of the inverse of a positive definite ``matrix`` (n, n) whose row and column have one owner.

    With the factors L D L^T the columns of the inverse Z follow from the last one to the first (Takahashi 1973):
    ``Z[S, j] = -Z[S, S] L[S, j]`` where S are the rows of column j in L, all of which are rows of the parent's column,
    too. So each column needs only a dense piece of its parent's; a walk down the elimination tree keeps few of them.

    Args:
        matrix: the information matrix.
        owners: (n,) the variable that each row belongs to.

    Returns:
        Rows, columns and values (E,) of the entries, for column <= row in the order of elimination. Those between parts
        that nothing couples are zero and left out: heights and tilts of a drive over flat ground are such a part.

    Raises:
        np.linalg.LinAlgError: the matrix is not positive definite.
    """
    factors = factorize(matrix)
    pivots = factors.U.diagonal()
    if not np.array_equal(factors.perm_r, factors.perm_c) or not np.all(pivots > 0.0):
        raise np.linalg.LinAlgError("the matrix is not positive definite")
    original = np.argsort(factors.perm_c)  # row of the matrix that each step of the elimination took
    lower = sparse.csc_array(factors.L)
    del factors  # it holds U, and L a second time
    lower.sort_indices()
    owners = owners * len(owners) + connected_components(abs(matrix) > 0.0, directed=False)[1]
    owners = owners[original]
    rows, columns, values = list[IntArray](), list[int](), list[FloatArray]()
    for column, front, piece in _walk(lower, pivots, owners):
        (own,) = (owners[front] == owners[column]).nonzero()
        rows.append(front[own])
        columns += [column] * len(own)
        values.append(piece[0, own])
    return original[np.concatenate(rows)], original[columns], np.concatenate(values)


def factorize(matrix: sparse.csc_array) -> SuperLU:
    """The factors of a symmetric ``matrix`` (n, n), in an order that keeps them sparse.

    Raises:
        np.linalg.LinAlgError: the matrix is singular.
    """
    try:
        return splu(
            matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True, "Equil": False}
        )
    except RuntimeError as error:
        raise np.linalg.LinAlgError(str(error)) from error


def _walk(lower: sparse.csc_array, pivots: FloatArray, owners: IntArray) -> Iterator[tuple[int, IntArray, FloatArray]]:
    """Each column with its front, the column and the rows below it, and the inverse over the front."""
    fronts, children, roots = _elimination_tree(lower, owners)
    starts = lower.indptr.tolist()
    stack = [(root, np.array([[1.0 / pivots[root]]])) for root in roots]
    while stack:
        column, piece = stack.pop()
        yield column, fronts[column], piece
        for child in sorted(children[column], key=lambda child: -len(fronts[child])):
            own = slice(starts[child], starts[child + 1])
            below = lower.data[own]
            if len(below) < len(fronts[child]):
                below = np.zeros(len(fronts[child]), dtype=np.float64)
                below[np.searchsorted(fronts[child], lower.indices[own])] = lower.data[own]
            stack.append((child, _extend(fronts[child], fronts[column], piece, below[1:], pivots[child])))


def _elimination_tree(lower: sparse.csc_array, owners: IntArray) -> tuple[list[IntArray], list[list[int]], list[int]]:
    """Fronts and children of all columns, and the columns without a parent.

    The rows of a column are rows of its parent's; where the factorisation left out a zero they are put back, as
    are rows of the column's owner that nothing couples with it.
    """
    starts, indices = lower.indptr.tolist(), lower.indices.astype(np.int64)
    fronts = [indices[start:end] for start, end in pairwise(starts)]
    for j, own in _owners_left_apart(lower, owners):
        fronts[j] = np.union1d(fronts[j], own)
    children: list[list[int]] = [[] for _ in fronts]
    roots = list[int]()
    for j, front in enumerate(fronts):
        if len(front) == 1:
            roots.append(j)
            continue
        parent = int(front[1])
        children[parent].append(j)
        above, below = fronts[parent], front[1:]
        places = np.searchsorted(above, below)
        if places[-1] >= len(above) or (above[places] != below).any():
            fronts[parent] = np.union1d(above, below)
    return fronts, children, roots


def _extend(front: IntArray, parent: IntArray, piece: FloatArray, column: FloatArray, pivot: float) -> FloatArray:
    """The inverse over the front of a column, from that over its parent's."""
    if len(front) == len(parent) + 1:
        below = piece
    else:
        places = np.searchsorted(parent, front[1:])
        below = piece.take(places, axis=0).take(places, axis=1)
    across = -(below @ column)
    extended = np.empty((len(front), len(front)), dtype=piece.dtype)
    extended[0, 0] = 1.0 / pivot - column @ across
    extended[0, 1:] = extended[1:, 0] = across
    extended[1:, 1:] = below
    return extended


def _owners_left_apart(lower: sparse.csc_array, owners: IntArray) -> Iterator[tuple[int, IntArray]]:
    """Columns that lack a row of their owner, with all rows of it from there on."""
    column_of = np.repeat(np.arange(len(owners)), np.diff(lower.indptr))
    is_own = owners[lower.indices] == owners[column_of]
    held = np.bincount(column_of[is_own], minlength=len(owners))
    by_owner = np.argsort(owners, kind="stable")
    place = np.empty(len(owners), dtype=np.int64)
    place[by_owner] = np.arange(len(owners))
    end = np.searchsorted(owners[by_owner], owners, side="right")
    for j in np.flatnonzero(held < end - place).tolist():
        yield j, by_owner[place[j] : end[j]]
