"""The array types that signatures name, and what of arrays needs NumPy alone; shapes and units stand in docstrings."""

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
ComplexArray = NDArray[np.complex128]


def median(values: FloatArray) -> float:
    """Of values (N,), one at least; much faster than NumPy's where they are few."""
    ascending = np.sort(values)
    return float(0.5 * (ascending[(len(values) - 1) // 2] + ascending[len(values) // 2]))


def least_eigenvalues(P: FloatArray) -> FloatArray:
    """Least eigenvalue (N,) of each of the symmetric matrices (N, n, n); -inf of those that are not finite."""
    is_finite = np.asarray(np.isfinite(P).all(axis=(1, 2)))
    return np.where(is_finite, np.linalg.eigvalsh(np.where(is_finite[:, None, None], P, 0.0))[:, 0], -np.inf)
