"""Voxels and clusters of points."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from logs.messages import FloatArray, IntArray


def voxel_means(points: FloatArray, voxel_m: float) -> FloatArray:
    """The mean of the points (N, 3) m in each voxel of side ``voxel_m``: (M, 3) m, M <= N."""
    corners = np.floor((points - points.min(axis=0)) / voxel_m).astype(np.int64)
    _, voxels, counts = np.unique(corners, axis=0, return_inverse=True, return_counts=True)
    sums = [np.bincount(voxels.ravel(), weights=axis) for axis in points.T]
    return np.stack(sums, axis=1) / counts[:, None]


def clusters(points: FloatArray, gap_m: float) -> IntArray:
    """Cluster (N,) of each of the points (N, D) m, from 0 on: those that a chain of steps of at most ``gap_m`` joins.

    DBSCAN (Ester et al., KDD 1996) in which every point is a core point.
    """
    i, j = cKDTree(points).query_pairs(gap_m, output_type="ndarray").T
    edges = coo_array((np.ones(len(i), dtype=np.bool_), (i, j)), shape=(len(points), len(points)))
    return np.asarray(connected_components(edges, directed=False)[1], dtype=np.int64)
