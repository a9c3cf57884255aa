"""Covariances of the variables of a graph: of each, of all at once, and of differences."""

from collections import defaultdict
from collections.abc import Iterable

import gtsam
import numpy as np
from scipy import sparse
from scipy.sparse.linalg import SuperLU, splu

from slam.backend.solver import graph_of, is_outlier, without_kernel
from slam.common.arrays import FloatArray, IntArray


def compute_marginals(factors: Iterable[gtsam.NonlinearFactor], values: gtsam.Values) -> dict[int, FloatArray]:
    """Covariances, (6, 6) of poses and (3, 3) of points, of all variables of an optimised graph, by their keys.

    Elimination leaves ``R x + S y = d`` for each variable x, given those y that follow. With the covariance P of y,
    ``A = -R^-1 S``, that of x is ``R^-1 R^-T + A P A^T``, and ``A P`` that of both. All of y, but for the first one,
    are what that one is given, so the covariances follow from the last variable to the first. GTSAM's own marginals
    eliminate anew for each variable, which takes twenty times as long where loops are closed.

    Raises:
        RuntimeError: the graph does not determine all variables.
    """
    net = without_kernels(factors, values).linearize(values).eliminateSequential()
    conditionals = {(each := net.at(row)).firstFrontalKey(): each for row in range(net.size())}
    order = {key: row for row, key in enumerate(conditionals)}
    children = defaultdict[int | None, list[int]](list)
    for key, conditional in conditionals.items():
        children[min(conditional.keys()[1:], key=order.__getitem__, default=None)].append(key)
    covariances = {}
    waiting = [(key, np.zeros(0, dtype=np.int64), np.zeros((0, 0))) for key in children[None]]
    while waiting:
        key, given, P = waiting.pop()
        conditional = conditionals[key]
        rows = np.concatenate([np.flatnonzero(given == each) for each in conditional.keys()[1:]] or [given])
        P = P.take(rows, axis=0).take(rows, axis=1)
        R_inverse = np.linalg.inv(conditional.R())
        A = -R_inverse @ conditional.S()
        across = A @ P
        covariances[key] = own = R_inverse @ R_inverse.T + across @ A.T
        joint = np.block([[own, across], [across.T, P]])
        owners = np.concatenate([np.full(len(own), key), given[rows]])
        # Those without children are done at once, so that few joint covariances wait.
        waiting += [(child, owners, joint) for child in sorted(children[key], key=lambda child: -len(children[child]))]
    return covariances


def offset_covariances(factors: Iterable[gtsam.NonlinearFactor], values: gtsam.Values, pairs: IntArray) -> FloatArray:
    """Covariances (P, 3, 3) of the differences between the points of pairs (P, 2) of keys, of an optimised graph.

    With H the information of all variables, the covariance of ``g^T x`` is ``g^T H^-1 g``.

    Raises:
        RuntimeError: the graph does not determine all variables.
    """
    information = factorize(linearize(factors, values)[0])
    keys = values.keys()  # in the order of the columns
    sizes = np.array([3 if gtsam.symbolChr(key) == ord("l") else 6 for key in keys])
    columns = (np.cumsum(sizes) - sizes)[np.searchsorted(keys, pairs)][:, :, None] + np.arange(3)
    size, found = values.dim(), np.zeros((len(pairs), 3, 3))
    for some in np.array_split(np.arange(len(pairs)), max(len(pairs) // 50, 1)):  # a few at a time, for memory
        first, second = columns[some].swapaxes(0, 1)
        pair, axis = np.arange(len(first))[:, None], np.arange(3)
        sides = np.zeros((size, len(first), 3))
        sides[first, pair, axis], sides[second, pair, axis] = 1.0, -1.0
        solved = information.solve(sides.reshape(size, -1)).reshape(sides.shape)
        found[some] = solved[first, pair] - solved[second, pair]
    return found


def linearize(factors: Iterable[gtsam.NonlinearFactor], values: gtsam.Values) -> tuple[sparse.csr_array, FloatArray]:
    """Jacobian (N, n) and residuals (N,) of factors at their optimum, each row divided by its standard deviation.

    Rows are in the order of the factors, columns in that of the keys of the variables.
    """
    linear = without_kernels(factors, values).linearize(values)
    row, column, entry = linear.sparseJacobian_()
    # Both are counted from one; the last column is the right side.
    places = row.astype(np.int32) - 1, column.astype(np.int32) - 1
    system = sparse.csc_array((entry, places), shape=(places[0].max() + 1, values.dim() + 1))
    return sparse.csr_array(system[:, :-1]), system[:, -1].toarray().ravel()


def factorize(jacobian: sparse.csr_array) -> SuperLU:
    """The factors of the information ``J^T J`` of a Jacobian J (N, n).

    Raises:
        RuntimeError: the rows do not determine all variables.
    """
    # In an order that keeps the factors of a symmetric matrix sparse.
    options = {"SymmetricMode": True, "Equil": False}
    matrix = sparse.csc_array(jacobian.T @ jacobian)
    return splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)


def without_kernels(factors: Iterable[gtsam.NonlinearFactor], values: gtsam.Values) -> gtsam.NonlinearFactorGraph:
    """A graph of factors at their optimum ``values``, with kernels at outliers only.

    Kernels weight observations and closures, by about half in the mean where the configured noise is true. These
    weights are not an estimate of the noise: in covariances all but outliers count with the noise that is configured.
    """
    return graph_of(each if is_outlier(each, values) else without_kernel(each) for each in factors)
