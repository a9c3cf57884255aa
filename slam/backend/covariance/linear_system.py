"""An optimised graph without kernels, linearised."""

from __future__ import annotations

from collections.abc import Iterable

import gtsam
import numpy as np
from scipy import sparse

from slam.backend.gtsam_calls import without_kernels
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
