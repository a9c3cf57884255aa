"""What Open3D does for point clouds here: the only module that imports it, and only when it is needed."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from logs.errors import DatasetError
from logs.messages import FloatArray, IntArray

REMEDY = "pip install 'descriptellation-slam[clouds]'; on Debian and Ubuntu it needs sudo apt install libusb-1.0-0"
FLIP_RADIUS = 100.0
"""Radius of the sphere of hidden-point removal, in distances of the farthest point: larger sees deeper into gaps."""


def open3d() -> Any:
    """Open3D.

    Raises:
        DatasetError: it cannot be imported; says why and what to install.
    """
    try:
        return importlib.import_module("open3d")
    except (ImportError, OSError) as error:
        raise DatasetError(f"point clouds need Open3D, which cannot be imported ({error}); {REMEDY}") from error


def voxel_means(points: FloatArray, voxel_m: float) -> FloatArray:
    """The mean of the points (N, 3) m in each voxel of side ``voxel_m``: (M, 3) m, M <= N."""
    means: FloatArray = np.asarray(_cloud(points).voxel_down_sample(voxel_m).points, dtype=np.float64)
    return means


def clusters(points: FloatArray, gap_m: float) -> IntArray:
    """Cluster (N,) of each of the points (N, 3) m, from 0 on: those that a chain of steps of at most ``gap_m`` joins.

    DBSCAN (Ester et al., KDD 1996) in which every point is a core point.
    """
    if len(points) == 0:
        return np.zeros(0, dtype=np.int64)
    return np.asarray(_cloud(points).cluster_dbscan(gap_m, 1), dtype=np.int64)


def visible(points: FloatArray, viewpoint: FloatArray) -> NDArray[np.bool_]:
    """Which of the points (N, 3) m no others hide from the ``viewpoint`` (3,) m: (N,).

    Hidden-point removal (Katz, Tal and Basri, SIGGRAPH 2007). Fewer than four points hide nothing.
    """
    seen = np.zeros(len(points), dtype=np.bool_)
    reach_m = float(np.linalg.norm(points - viewpoint, axis=1).max(initial=0.0))
    if len(points) < 4 or reach_m == 0.0:
        return ~seen
    _, rows = _cloud(points).hidden_point_removal(viewpoint, FLIP_RADIUS * reach_m)
    seen[np.asarray(rows, dtype=np.int64)] = True
    return seen


def _cloud(points: FloatArray) -> Any:
    o3d = open3d()
    return o3d.geometry.PointCloud(o3d.utility.Vector3dVector(np.ascontiguousarray(points, dtype=np.float64)))
