"""Marginal covariances of all keyframes and landmarks at once."""

from __future__ import annotations

from collections.abc import Iterable

import gtsam
import numpy as np
from scipy import sparse

from slam.backend.covariance.linear_system import linearize
from slam.backend.covariance.selected_inverse import diagonal_blocks_of_inverse
from slam.common.arrays import FloatArray


def compute_marginals(factors: Iterable[gtsam.NonlinearFactor], values: gtsam.Values) -> dict[int, FloatArray]:
    """Covariances, (6, 6) of poses and (3, 3) of points, of all variables of an optimised graph, by their keys.

    GTSAM's own marginals eliminate anew for each variable, which takes twenty times as long where loops are closed.

    Raises:
        np.linalg.LinAlgError: the graph does not determine all variables.
    """
    jacobian, _ = linearize(factors, values)
    keys = sorted(values.keys())
    sizes = np.array([6 if gtsam.symbolChr(key) == ord("x") else 3 for key in keys])
    owners, starts = np.repeat(np.arange(len(keys)), sizes), np.cumsum(sizes) - sizes
    rows, columns, entries = diagonal_blocks_of_inverse(sparse.csc_array(jacobian.T @ jacobian), owners)
    owner = owners[rows]
    blocks = np.zeros((len(keys), 6, 6))
    blocks[owner, rows - starts[owner], columns - starts[owner]] = entries
    blocks[owner, columns - starts[owner], rows - starts[owner]] = entries
    return {key: block[:size, :size] for key, block, size in zip(keys, blocks, sizes.tolist(), strict=True)}
