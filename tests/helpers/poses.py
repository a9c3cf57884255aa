"""Poses of bodies that stand upright."""

from __future__ import annotations

import numpy as np

from slam.common.arrays import FloatArray
from slam.common.geometry import transform_from_xyz_yaw


def pose_at(x: float = 0.0, y: float = 0.0, *, z: float = 0.0, yaw: float = 0.0) -> FloatArray:
    """(4, 4), in metres and radians."""
    return transform_from_xyz_yaw(np.array([x, y, z], dtype=np.float64), yaw)
