"""The area in which a robot that is somewhere in the map can be."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slam.common.arrays import FloatArray
from slam.odometry.keyframe import Keyframe


class MapArea:
    """Area of the square cells, with edges of ``cell_m``, with a keyframe or an object of an imported map."""

    def __init__(self, *, cell_m: float) -> None:
        self._cell_m = cell_m
        self._cells: set[tuple[int, int, int]] = set()
        self._covered = 0

    def cover(self, keyframes: Sequence[Keyframe]) -> None:
        """Add the keyframes, given in their order, that are new."""
        for keyframe in keyframes[self._covered :]:
            self.cover_positions(keyframe.T_local_body[None, :2, 3], segment=keyframe.odometry.segment)
        self._covered = len(keyframes)

    def cover_positions(self, positions: FloatArray, *, segment: int = 0) -> None:
        """Add positions (K, 2) m where the robot can be in a segment."""
        cells = np.unique((positions // self._cell_m).astype(np.int64), axis=0).tolist()
        self._cells.update((segment, x, y) for x, y in cells)

    @property
    def area_m2(self) -> float:
        """The area in square metres, at least that of one cell."""
        return max(len(self._cells), 1) * self._cell_m**2
