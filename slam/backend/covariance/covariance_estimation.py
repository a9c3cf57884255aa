"""Covariances of an optimised graph whose noise differs from the configured noise.

The marginals of least squares assume that the configured noise of every factor is true. They are corrected in two ways:

* Robust kernels weight observations and closures, by about half in the mean where the configured noise is true. These
  weights are not an estimate of the noise: all but outliers, whose residuals have ``OUTLIER_PROBABILITY``, keep the
  configured noise. How far the estimate follows them is their ``kernel_weight``, the mean slope of the influence.
* The errors of odometry are correlated. An error of its scale is the same for many steps, so the sum is larger than
  the covariances of the steps predict. Its variance is estimated from the drive: over stretches of 50 steps the
  residuals of all steps are added up, axis by axis. The variance of closures is estimated likewise. The final estimate
  of a drive has this noise, too (``FactorGraph.match_noise``).

With rows a of the Jacobian, their kernel weights t and the factors f on their variance, the estimate has the covariance
H^-1 M H^-1, H = sum t a a^T, M = sum t^2 f a a^T (the "sandwich": Huber 1967, The behavior of maximum likelihood
estimates under nonstandard conditions).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.special import chdtr, gammaincinv

from slam.backend.covariance.selected_inverse import diagonal_blocks_of_inverse, factorize
from slam.common.arrays import BoolArray, FloatArray, IntArray

OUTLIER_PROBABILITY = 0.001
STRETCH_STEPS = 50
"""Steps of the odometry over which its error is looked at: 100 m of keyframes every 2 m."""
MIN_SAMPLES, MAX_SAMPLES = 5, 20
"""Of stretches or closures: fewer are not significant, more would cost time and add little."""
ROUNDS = 10
"""Of expectation and maximisation. They begin with the configured noise, and near none at all they are slow."""
FACTOR_LIMITS = (1e-3, 1e2)
MIN_INFORMATION = 0.01
TEST_PROBABILITY = 0.05
COMPLEX_STEP = 1e-12
POSE_SIZE = 6
SOLVED_AT_ONCE = 48
"""Right sides, which are dense."""


@dataclass(frozen=True, slots=True, eq=False)
class LinearSystem:
    """An optimised graph, linearised; every row is divided by its standard deviation.

    jacobian (N, n) and residuals (N,); kernel_weight (N,) in (0, 1]: share of the information of a row that the
    solver uses;
    odometry_rows (S, 6) and closure_rows (C, 6): those of the steps of the odometry, one after another, and of the
    closures, rotation first; owners (n,): which variable each column belongs to, from 0 without gaps, in their order.
    """

    jacobian: sparse.csr_array
    residuals: FloatArray
    kernel_weight: FloatArray
    odometry_rows: IntArray
    closure_rows: IntArray
    owners: IntArray


def outlier_limit(dimension: int) -> float:
    """The squared residual, in standard deviations, beyond which it is an outlier's."""
    return float(2.0 * gammaincinv(0.5 * dimension, 1.0 - OUTLIER_PROBABILITY))


def variance_factors(system: LinearSystem) -> FloatArray:
    """Variance factors (N,) of the rows, relative to the assumed variances.

    It is 1 but for the odometry and the closures, which have one factor for each of their six axes; and 1 also where a
    drive has too little of them to tell, or where chance may explain the difference: the global test of geodesy, by the
    sum of the squared residuals and its expectation, the redundancy (Förstner and Wrobel, Photogrammetric Computer
    Vision, 2016, section 4.6.8).

    The error of the odometry over a stretch, or of a closure, is known from its residual r, and as well as the
    optimised graph knows it, with the variance p. Its variance s over all of them is estimated by expectation and
    maximisation (Dempster et al. 1977), each axis by itself.

    Raises:
        np.linalg.LinAlgError: the graph does not determine all variables.
    """
    factors = np.ones(len(system.residuals))
    stretches = len(system.odometry_rows) // STRETCH_STEPS
    full_stretches = system.odometry_rows[: stretches * STRETCH_STEPS].reshape(stretches, STRETCH_STEPS, POSE_SIZE)
    groups = [
        (rows, _spread_out(samples))
        for rows, samples in (
            (system.odometry_rows, full_stretches),
            (system.closure_rows, system.closure_rows[:, None]),
        )
        if len(samples) >= MIN_SAMPLES
    ]
    if not groups:
        return factors
    adding = sparse.vstack([_adding(samples, len(factors)) for _, samples in groups], format="csr")
    residuals = (adding @ system.residuals).reshape(-1, POSE_SIZE)
    posterior = _posterior_variances(system, adding).reshape(-1, POSE_SIZE)
    start = 0
    for rows, samples in groups:
        part = slice(start, start + len(samples))
        # Their information beside that of the row itself; what is next to nothing is nothing.
        measured = 1.0 / posterior[part] - system.kernel_weight[rows[0, 0]]
        measured = np.where(measured < MIN_INFORMATION, 0.0, measured)
        found = _maximize(residuals[part], posterior[part], measured)
        factors[rows] = np.where(_differs(residuals[part], posterior[part], measured), found, 1.0)
        start += len(samples)
    return factors


def _spread_out(samples: IntArray) -> IntArray:
    """At most ``MAX_SAMPLES`` of them, spread evenly."""
    last = len(samples) - 1
    return samples[np.unique(np.linspace(0, last, min(last + 1, MAX_SAMPLES)).round().astype(np.int64))]


def _adding(samples: IntArray, row_count: int) -> sparse.csr_array:
    """(S * 6, N): adds up the rows (S, K, 6) of each sample, and divides by the root of K."""
    sums = np.broadcast_to(np.arange(len(samples) * POSE_SIZE).reshape(-1, 1, POSE_SIZE), samples.shape)
    weights = np.full(samples.size, 1.0 / np.sqrt(samples.shape[1]))
    return sparse.csr_array((weights, (sums.ravel(), samples.ravel())), shape=(len(samples) * POSE_SIZE, row_count))


def _posterior_variances(system: LinearSystem, adding: sparse.csr_array) -> FloatArray:
    """Variance (S,) that the optimised graph leaves to each of those sums of rows."""
    sensitivity = sparse.csr_array(adding @ system.jacobian)
    factorized = factorize(_information(system, system.kernel_weight))
    variances = np.zeros(sensitivity.shape[0])
    for start in range(0, len(variances), SOLVED_AT_ONCE):
        part = slice(start, start + SOLVED_AT_ONCE)
        columns = sensitivity[part].toarray().T
        variances[part] = np.einsum("ni,ni->i", columns, factorized.solve(columns))
    return variances


def _maximize(residuals: FloatArray, posterior: FloatArray, measured: FloatArray) -> FloatArray:
    """Variance (6,) of errors, from residuals (S, 6), variances (S, 6), and the information (S, 6) of other factors."""
    variance = np.ones(POSE_SIZE)
    for _ in range(ROUNDS):
        left = variance / (1.0 + variance * measured)
        expected = np.where(measured > 0.0, left / posterior * residuals, 0.0)
        variance = np.clip(np.mean(expected**2 + left, axis=0), *FACTOR_LIMITS)
    return variance


def _differs(residuals: FloatArray, posterior: FloatArray, measured: FloatArray) -> BoolArray:
    """Whether (6,) the residuals reject a variance of 1, by their sum and the redundancy."""
    redundancy = measured / (1.0 + measured)
    squares = np.where(measured > 0.0, (residuals / posterior) ** 2 / (1.0 + measured) ** 2, 0.0)
    chance = chdtr(np.maximum(redundancy.sum(axis=0), 1e-9), squares.sum(axis=0))
    return np.asarray(np.minimum(chance, 1.0 - chance) < 0.5 * TEST_PROBABILITY)


def covariance_blocks(system: LinearSystem, factors: FloatArray) -> FloatArray:
    """Covariances (V, 6, 6) of all variables, in their order; those of fewer than six columns are filled up by zeros.

    Args:
        system: the graph.
        factors: (N,) on the variance of its rows.

    Raises:
        np.linalg.LinAlgError: the graph does not determine all variables.
    """
    information = _information(system, system.kernel_weight)
    noise = system.kernel_weight**2 * factors
    if np.any(noise != system.kernel_weight):
        # The derivative of an inverse is -H^-1 M H^-1; a step along the imaginary axis gives it without a difference.
        information = sparse.csc_array(information + 1j * COMPLEX_STEP * _information(system, noise))
    rows, columns, entries = diagonal_blocks_of_inverse(information, system.owners)
    values = -entries.imag / COMPLEX_STEP if np.iscomplexobj(entries) else entries
    owner = system.owners[rows]
    starts = np.searchsorted(system.owners, owner)
    blocks = np.zeros((int(system.owners[-1]) + 1 if len(system.owners) else 0, POSE_SIZE, POSE_SIZE))
    blocks[owner, rows - starts, columns - starts] = values
    blocks[owner, columns - starts, rows - starts] = values
    return blocks


def _information(system: LinearSystem, weights: FloatArray) -> sparse.csc_array:
    return sparse.csc_array(system.jacobian.T @ (sparse.diags_array(weights) @ system.jacobian))
