"""A LiDAR in a world of boxes and poles: which point of which object each of its beams meets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from logs.messages import FloatArray, IntArray

GROUND = 40
_HIGHEST = 1.0e6


@dataclass(frozen=True)
class Solid:
    """On the ground at (x, y); ``size``: length, width and height of a box that is turned by ``yaw``, or, where
    ``is_round``, twice the diameter and the height of a pole.
    """

    number: int
    x: float
    y: float
    size: tuple[float, float, float]
    yaw: float = 0.0
    is_round: bool = False


def beams(rows: int = 16, columns: int = 1800, spread_deg: float = 15.0) -> FloatArray:
    """Unit directions (rows * columns, 3)."""
    elevation, azimuth = np.meshgrid(
        np.deg2rad(np.linspace(-spread_deg, spread_deg, rows)), np.linspace(0.0, 2.0 * np.pi, columns, endpoint=False)
    )
    flat = np.cos(elevation)
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=-1).reshape(-1, 3)


def cast(
    solids: Sequence[Solid],
    T_world_sensor: FloatArray,
    directions: FloatArray,
    *,
    max_range_m: float = 40.0,
    noise_m: float = 0.02,
    rng: np.random.Generator,
) -> tuple[FloatArray, IntArray]:
    """Points (N, 3) m in the frame of the sensor, and the class of each (N,), ``GROUND`` for the ground at z = 0."""
    rays, origin = directions @ T_world_sensor[:3, :3].T, T_world_sensor[:3, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        nearest = np.where(rays[:, 2] < 0.0, -origin[2] / rays[:, 2], np.inf)
        hit = np.full(len(rays), GROUND)
        for solid in solids:
            if np.hypot(solid.x - origin[0], solid.y - origin[1]) > max_range_m:
                continue
            distance = _pole(solid, origin, rays) if solid.is_round else _box(solid, origin, rays)
            closer = distance < nearest
            nearest, hit = np.where(closer, distance, nearest), np.where(closer, solid.number, hit)
    seen = nearest < max_range_m
    distances = nearest[seen] + rng.normal(0.0, noise_m, int(seen.sum()))
    return directions[seen] * distances[:, None], hit[seen]


def _pole(solid: Solid, origin: FloatArray, rays: FloatArray) -> FloatArray:
    """Distances (N,) along the rays, inf where they miss the side of the pole."""
    offset = origin[:2] - [solid.x, solid.y]
    a = np.sum(rays[:, :2] ** 2, axis=1)
    b = rays[:, :2] @ offset
    root = b**2 - a * (offset @ offset - (0.5 * solid.size[0]) ** 2)
    distance = np.where(root >= 0.0, (-b - np.sqrt(np.maximum(root, 0.0))) / a, np.inf)
    height = origin[2] + distance * rays[:, 2]
    return np.where((distance > 0.0) & (height >= 0.0) & (height <= solid.size[2]), distance, np.inf)


def _box(solid: Solid, origin: FloatArray, rays: FloatArray) -> FloatArray:
    """Distances (N,) along the rays, inf where they miss the box (slab method)."""
    c, s = np.cos(solid.yaw), np.sin(solid.yaw)
    turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    half = 0.5 * np.array(solid.size)
    start, ways = turn @ (origin - [solid.x, solid.y, half[2]]), rays @ turn.T
    inverse = np.where(ways == 0.0, _HIGHEST, 1.0 / ways)
    low, high = (-half - start) * inverse, (half - start) * inverse
    enter, leave = np.minimum(low, high).max(axis=1), np.maximum(low, high).min(axis=1)
    return np.where((enter <= leave) & (enter > 0.0), enter, np.inf)
