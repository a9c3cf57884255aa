"""Connectivity of the segments of the odometry: which of them closures have connected."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slam.common.arrays import IntArray
from slam.common.union_find import UnionFind
from slam.odometry.keyframe import Keyframe


class SegmentConnectivity:
    """Connected components of the segments; each is identified by its first segment."""

    def __init__(self, keyframes: Sequence[Keyframe]) -> None:
        self._keyframes = keyframes
        self._components = UnionFind()

    def are_connected(self, first: int, second: int) -> bool:
        """Whether odometry or closures connect two keyframes."""
        return self._component_of(first) == self._component_of(second)

    def connect(self, first: int, second: int) -> IntArray:
        """Merge the components of two keyframes; returns the keyframes (K,) of the later one, none if they were one."""
        kept, moved = sorted((self._component_of(first), self._component_of(second)))
        if kept == moved:
            return np.zeros(0, dtype=np.int64)
        moving = [keyframe.id for keyframe in self._keyframes if self._component_of(keyframe.id) == moved]
        self._components.merge(kept, moved)
        return np.array(moving, dtype=np.int64)

    def reset(self) -> None:
        """Disconnect all segments."""
        self._components = UnionFind()

    def _component_of(self, keyframe: int) -> int:
        return self._components.find(self._keyframes[keyframe].odometry.segment)
