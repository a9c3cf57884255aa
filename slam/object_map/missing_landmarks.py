"""Landmarks of a prior map that disappeared: the robot passed them and never observed them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from slam.common.arrays import FloatArray, IntArray
from slam.common.config import SUBMAP_RANGES
from slam.common.geometry import apply, invert
from slam.object_map.landmarks import LandmarkState, ObjectMap
from slam.object_map.submap import gravity_frame
from slam.odometry.keyframe import Keyframe

PASSED_RANGES = 0.5
"""All objects so near to the path of the robot, in sensor ranges, have been seen when it has driven on for as long."""


class MissingLandmarks:
    """Counts of the passes of each landmark of a prior map, and the landmarks that were matched."""

    def __init__(self, object_map: ObjectMap, keyframes: Sequence[Keyframe], sensor_range_m: float) -> None:
        self._map = object_map
        self._keyframes = keyframes
        self._sensor_range_m = sensor_range_m
        self._passed: Counter[int] = Counter()
        self._matched: set[int] = set()

    def add(self, keyframe: Keyframe, T_map_gravity: FloatArray, matched: IntArray) -> None:
        """Add a closure with the map.

        Args:
            keyframe: the query.
            T_map_gravity: (4, 4) of its gravity frame in the map.
            matched: (K,) rows of the landmarks of the map that it matched.
        """
        self._matched.update(matched.tolist())
        path = self._path_before(keyframe)
        if not len(path):
            return
        landmarks = self._map.rows
        in_map = (landmarks["segment"] == self._keyframes[0].odometry.segment) & (
            landmarks["state"] == LandmarkState.CONFIRMED
        )
        rows = np.flatnonzero(in_map)
        T_map_local = T_map_gravity @ invert(gravity_frame(keyframe.T_local_body))
        apart_m, _ = cKDTree(apply(T_map_local, path)[:, :2]).query(
            landmarks["position_local"][rows, :2], distance_upper_bound=PASSED_RANGES * self._sensor_range_m
        )
        self._passed.update(rows[np.isfinite(apart_m)].tolist())

    def rows(self) -> IntArray:
        """Rows (K,) of the missing landmarks: passed at six closures, and matched at none."""
        missing = [row for row, count in self._passed.items() if count >= 6 and row not in self._matched]
        return np.array(sorted(missing), dtype=np.int64)

    def _path_before(self, last: Keyframe) -> FloatArray:
        """Where the robot was (P, 3) m on its segment, so long ago that all around is mapped by now."""
        latest_m = last.odometry.travel_m - PASSED_RANGES * self._sensor_range_m
        earliest_m = last.odometry.travel_m - SUBMAP_RANGES * self._sensor_range_m
        path = list[FloatArray]()
        for keyframe in reversed(self._keyframes[: last.id]):
            pose = keyframe.odometry
            if pose.segment != last.odometry.segment or pose.travel_m < earliest_m:
                break
            if pose.travel_m <= latest_m:
                path.append(keyframe.T_local_body[:3, 3])
        return np.array(path).reshape(-1, 3)
