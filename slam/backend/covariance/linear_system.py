"""An optimised graph without kernels, linearised."""

from __future__ import annotations

from collections.abc import Iterable

import gtsam
import numpy as np
from scipy import sparse

from slam.backend.solver import graph_of
from slam.common.arrays import FloatArray


def linearize(factors: Iterable[gtsam.NonlinearFactor], values: gtsam.Values) -> tuple[sparse.csr_array, FloatArray]:
    """Jacobian (N, n) and residuals (N,) of factors at their optimum, each row divided by its standard deviation.

    Rows are in the order of the factors, columns in that of the keys of the variables.
    """
    linear = without_kernels(factors, values).linearize(values)
    row, column, entry = np.asarray(linear.sparseJacobian_())
    # Both are counted from one; the last column is the right side.
    places = row.astype(np.int32) - 1, column.astype(np.int32) - 1
    system = sparse.csc_array((entry, places), shape=(places[0].max() + 1, values.dim() + 1))
    return sparse.csr_array(system[:, :-1]), system[:, -1].toarray().ravel()


def without_kernels(factors: Iterable[gtsam.NonlinearFactor], values: gtsam.Values) -> gtsam.NonlinearFactorGraph:
    """A graph of factors at their optimum ``values``, with kernels at outliers only.

    Kernels weight observations and closures, by about half in the mean where the configured noise is true. These
    weights are not an estimate of the noise: in covariances all but outliers count with the noise that is configured.
    """
    return graph_of(_without_kernel(factor, values) for factor in factors)


def _without_kernel(factor: gtsam.NonlinearFactor, values: gtsam.Values) -> gtsam.NonlinearFactor:
    if not isinstance(factor, gtsam.NoiseModelFactor):
        return factor
    noise = factor.noiseModel()
    if not isinstance(noise, gtsam.noiseModel.Robust):
        return factor
    plain = factor.cloneWithNewNoiseModel(noise.noise())
    # Less weight than a tenth have outliers, and 1 in 1000 observations without faults.
    return plain if noise.weight(plain.whitenedError(values)) >= 0.1 else factor
