"""Landmarks of a prior map that the robot passed: those that it did not observe disappeared."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from slam.common.arrays import FloatArray, IntArray
from slam.object_map.landmarks import LandmarkState, ObjectMap


def find_passed(object_map: ObjectMap, segment: int, places: FloatArray, radius_m: float) -> IntArray:
    """Rows (K,) of the confirmed landmarks of a segment that were passed at six keyframes.

    Args:
        object_map: at the end of the drive.
        segment: of the landmarks.
        places: (P, 3) m in the map, of keyframes.
        radius_m: all objects so near to a keyframe have been seen there.
    """
    landmarks = object_map.rows
    rows = np.flatnonzero((landmarks["state"] == LandmarkState.CONFIRMED) & (landmarks["segment"] == segment))
    positions = landmarks["position_map"][rows, :2]
    counts = cKDTree(places[:, :2]).query_ball_point(positions, radius_m, return_length=True)
    return rows[np.asarray(counts) >= 6]
