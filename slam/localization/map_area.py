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
        self._cells: dict[int, set[int]] = {}
        self._covered = 0

    def cover(self, keyframes: Sequence[Keyframe]) -> None:
        """Add the keyframes, given in their order, that are new."""
        for keyframe in keyframes[self._covered :]:
            self.cover_positions(keyframe.T_local_body[None, :2, 3], segment=keyframe.odometry.segment)
        self._covered = len(keyframes)

    def cover_positions(self, positions: FloatArray, *, segment: int = 0) -> None:
        """Add positions (K, 2) m where the robot can be in a segment."""
        columns, rows = (positions // self._cell_m).astype(np.int64).T
        # No map has so many rows of cells.
        self._cells.setdefault(segment, set()).update(np.unique(columns * 2**32 + rows).tolist())

    @property
    def area_m2(self) -> float:
        """The area in square metres, at least that of one cell."""
        return max(sum(map(len, self._cells.values())), 1) * self._cell_m**2
