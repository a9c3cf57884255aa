"""The noise of the odometry that its residuals show, where it is another than configured.

The errors of odometry are correlated. An error of its scale, or a gyroscope whose bias changes slowly, is the same for
many steps, so the sum is larger than the covariances of the steps predict. Its variance is estimated from the drive:
over stretches of it the residuals of all steps are added up, axis by axis. Over how many steps errors are correlated is
not known, so there are long stretches and short ones, and the larger variance counts.
"""

from collections.abc import Mapping

import gtsam
import numpy as np
from scipy import sparse
from scipy.special import chdtr

from slam.backend.covariance.marginals import factorize, linearize
from slam.backend.factors import Edge, EdgeKind, Factor
from slam.common.arrays import BoolArray, FloatArray, IntArray

FEW, MANY = 5, 20
"""Stretches of a drive, long and short ones: fewer are not significant, more would cost time and add little."""


def matched_covariances(
    records: Mapping[int, Factor], factors: Mapping[int, gtsam.NonlinearFactor], values: gtsam.Values
) -> dict[int, FloatArray]:
    """The covariances (6, 6) of the odometry that the drive itself shows, by the numbers of its edges, if they differ.

    Args:
        records: of all factors, by number.
        factors: the same of the solver.
        values: the optimum.

    Raises:
        RuntimeError: the graph does not determine all variables.
    """
    edges = {
        number: each
        for number, each in records.items()
        if isinstance(each, Edge) and each.kind not in (EdgeKind.GNSS, EdgeKind.LOOP_CLOSURE)
    }
    sizes = np.array([factor.dim() for factor in factors.values()])
    starts = dict(zip(factors, (np.cumsum(sizes) - sizes).tolist(), strict=True))
    rows = np.array([starts[number] for number in edges], dtype=np.int64)[:, None] + np.arange(6)
    jacobian, residuals = linearize(factors.values(), values)
    found = variance_factors(jacobian, residuals, rows)
    if (found == 1.0).all():
        return {}
    return {number: _scaled(each.covariance, found) for number, each in edges.items()}


def variance_factors(jacobian: sparse.csr_array, residuals: FloatArray, rows: IntArray) -> FloatArray:
    """Factors (6,) on the variances of the odometry, axis by axis.

    It is 1 where a drive has too few steps to tell, or where chance may explain the difference: the global test of
    geodesy, by the sum of the squared residuals and its expectation, the redundancy (Förstner and Wrobel,
    Photogrammetric Computer Vision, 2016, section 4.6.8).

    The error over a stretch of steps is known from its residual r, and as well as the optimised graph knows it, with
    the variance p. Its variance s over all of them is estimated by expectation and maximisation (Dempster et al. 1977),
    each axis by itself.

    Args:
        jacobian: (N, n) of all factors; each row is divided by its standard deviation.
        residuals: (N,), likewise.
        rows: (E, 6) of the steps, one after another, rotation first.

    Raises:
        RuntimeError: the graph does not determine all variables.
    """
    factors = np.ones((2, 6))
    if len(rows) < FEW:
        return factors[0]
    information = factorize(jacobian)
    for row, length in enumerate((len(rows) // FEW, max(len(rows) // MANY, 1))):
        sums = _sums_of(rows[: len(rows) // length * length].reshape(-1, length, 6), len(residuals))
        columns = (sums @ jacobian).toarray().T
        errors = (sums @ residuals).reshape(-1, 6)
        posterior = np.einsum("ni,ni->i", columns, information.solve(columns)).reshape(-1, 6)
        # What other factors add to the information of the row; less than a hundredth of it is taken to be none.
        measured = 1.0 / posterior - 1.0
        is_measured = measured >= 0.01
        errors, measured = np.where(is_measured, errors, 0.0), np.where(is_measured, measured, 0.0)
        factors[row] = np.where(_differs(errors, measured), _maximize(errors, measured), 1.0)
    return np.asarray(factors.max(axis=0))


def _sums_of(samples: IntArray, row_count: int) -> sparse.csr_array:
    """(S * 6, N): adds up the rows (S, K, 6) of each sample, and divides by the root of K."""
    sums = np.broadcast_to(np.arange(len(samples) * 6).reshape(-1, 1, 6), samples.shape)
    weights = np.full(samples.size, 1.0 / np.sqrt(samples.shape[1]))
    return sparse.csr_array((weights, (sums.ravel(), samples.ravel())), shape=(len(samples) * 6, row_count))


def _maximize(residuals: FloatArray, measured: FloatArray) -> FloatArray:
    """Variance (6,) of errors, from residuals (S, 6) and the information (S, 6) of other factors."""
    variance = np.ones(6)
    for _ in range(10):  # from the configured noise; near none at all the iteration is slow
        left = variance / (1.0 + variance * measured)
        expected = left * (1.0 + measured) * residuals
        variance = np.clip(np.mean(expected**2 + left, axis=0), 1e-3, 1e2)
    return variance


def _differs(residuals: FloatArray, measured: FloatArray) -> BoolArray:
    """Whether (6,) the residuals reject a variance of 1 at the level of 5 %, by their sum and the redundancy."""
    redundancy = measured / (1.0 + measured)
    chance = chdtr(np.maximum(redundancy.sum(axis=0), 1e-9), np.sum(residuals**2, axis=0))
    return np.minimum(chance, 1.0 - chance) < 0.5 * 0.05


def _scaled(covariance: FloatArray, factors: FloatArray) -> FloatArray:
    """A covariance (6, 6) with variances scaled by ``factors`` (6,) along the axes that GTSAM whitens."""
    axes = np.linalg.cholesky(covariance[::-1, ::-1])[::-1, ::-1]
    return (axes * factors) @ axes.T
