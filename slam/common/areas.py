"""Areas of the plane: which positions lie in them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from slam.common.arrays import BoolArray, FloatArray
from slam.common.errors import GeometryError


class Area(Protocol):
    """A part of the plane."""

    def contains(self, positions: FloatArray) -> BoolArray:
        """Which positions (N, 2 or 3) m lie in it (N,), by x and y."""
        ...


@dataclass(frozen=True, slots=True)
class Circle:
    """Around (``x_m``, ``y_m``), its edge included."""

    x_m: float
    y_m: float
    radius_m: float

    def __post_init__(self) -> None:
        if not self.radius_m > 0.0:
            raise GeometryError(f"a circle has a radius of more than 0 m, not {self.radius_m:g}")

    def contains(self, positions: FloatArray) -> BoolArray:
        """Which positions (N, 2 or 3) m lie in it (N,), by x and y."""
        distances_m = np.hypot(positions[:, 0] - self.x_m, positions[:, 1] - self.y_m)
        return np.asarray(distances_m <= self.radius_m)


@dataclass(frozen=True, slots=True, eq=False)
class Polygon:
    """``corners`` (V, 2) m, V at least 3, in either order; the last one is followed by the first one."""

    corners: FloatArray

    def __post_init__(self) -> None:
        if len(self.corners) < 3:
            raise GeometryError(f"a polygon has at least 3 corners, not {len(self.corners)}")

    def contains(self, positions: FloatArray) -> BoolArray:
        """Which positions (N, 2 or 3) m lie in it (N,), by x and y: a ray from there crosses an odd number of sides."""
        x, y = positions[:, :1], positions[:, 1:2]
        (x0, y0), (x1, y1) = self.corners.T, np.roll(self.corners, -1, axis=0).T
        straddles = (y0 <= y) != (y1 <= y)
        with np.errstate(divide="ignore", invalid="ignore"):
            crossing_x = x0 + (y - y0) * (x1 - x0) / (y1 - y0)
        return np.asarray(np.count_nonzero(straddles & (x < crossing_x), axis=1) % 2 == 1)
