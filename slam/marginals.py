"""Marginal covariances of all landmarks at once."""

from __future__ import annotations

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L
from scipy import sparse

from slam.geometry import FloatArray, IntArray
from slam.selected_inverse import diagonal_blocks_of_inverse

POSE_SIZE, POINT_SIZE = 6, 3


def landmark_marginals(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, landmarks: IntArray) -> FloatArray:
    """Covariances (N, 3, 3) m^2 of ``landmarks`` (N,) in a graph of poses and points, linearised at ``values``.

    GTSAM's own marginals eliminate anew for each variable, which takes ten times as long where loops are closed.

    Raises:
        np.linalg.LinAlgError: the graph does not determine all variables.
    """
    # The columns stand in the order of the keys, and the letter of a landmark comes before that of a pose.
    keys = np.array(sorted(values.keys()), dtype=np.uint64)
    points = int(np.searchsorted(keys, np.uint64(L(0)) + np.uint64(1 << 56)))
    sizes = np.where(np.arange(len(keys)) < points, POINT_SIZE, POSE_SIZE)
    owners = np.repeat(np.arange(len(keys)), sizes)
    row, column, entry = np.asarray(graph.linearize(values).sparseJacobian_())
    of_variables = column <= len(owners)  # counted from one; the last column is the right side
    places = (row[of_variables].astype(np.int64) - 1, column[of_variables].astype(np.int64) - 1)
    jacobian = sparse.csc_array((entry[of_variables], places), shape=(int(row.max()), len(owners)))
    rows, columns, entries = diagonal_blocks_of_inverse(sparse.csc_array(jacobian.T @ jacobian), owners)
    covariances = np.zeros((points, POINT_SIZE, POINT_SIZE))
    of_points = rows < points * POINT_SIZE
    rows, columns, entries = rows[of_points], columns[of_points], entries[of_points]
    owner = owners[rows]
    covariances[owner, rows % POINT_SIZE, columns % POINT_SIZE] = entries
    covariances[owner, columns % POINT_SIZE, rows % POINT_SIZE] = entries
    wanted = np.array([L(int(landmark)) for landmark in landmarks], dtype=np.uint64)
    return np.asarray(covariances[np.searchsorted(keys, wanted)])
