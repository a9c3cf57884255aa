"""Stretches between breaks of the odometry, and which of them closures have joined."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slam.common.arrays import IntArray
from slam.odometry.keyframe import Keyframe


class Sessions:
    """Groups of segments of the odometry; a group goes by its first segment."""

    def __init__(self, keyframes: Sequence[Keyframe]) -> None:
        self._keyframes = keyframes
        self._group: dict[int, int] = {}

    def are_joined(self, first: int, second: int) -> bool:
        """Whether odometry or closures tie two keyframes together."""
        return self._group_of(first) == self._group_of(second)

    def join(self, first: int, second: int) -> IntArray:
        """Make one of the groups of two keyframes; returns the keyframes (K,) of the later one, none if it was one."""
        kept, moved = sorted((self._group_of(first), self._group_of(second)))
        if kept == moved:
            return np.zeros(0, dtype=np.int64)
        moving = [keyframe.id for keyframe in self._keyframes if self._group_of(keyframe.id) == moved]
        for segment in {self._keyframes[keyframe].odometry.segment for keyframe in moving}:
            self._group[segment] = kept
        return np.array(moving, dtype=np.int64)

    def part(self) -> None:
        """Forget all that was joined."""
        self._group.clear()

    def _group_of(self, keyframe: int) -> int:
        segment = self._keyframes[keyframe].odometry.segment
        return self._group.get(segment, segment)
