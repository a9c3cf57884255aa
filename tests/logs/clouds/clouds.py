"""Labelled clouds for tests: poles and boxes of which a sensor sees one side."""

from collections.abc import Sequence

import numpy as np

from logs.clouds.labelled_cloud import LabelledCloud
from logs.messages import FloatArray


def post(x_m: float, y_m: float, *, radius_m: float = 0.15, height_m: float = 3.0) -> FloatArray:
    """Points (N, 3) m of the half of a round post that is seen from the origin."""
    facing = np.arctan2(-y_m, -x_m) + np.linspace(-0.5, 0.5, 15) * np.pi
    z = np.arange(0.0, height_m, 0.1) - 1.0
    ring = np.array([x_m, y_m]) + radius_m * np.stack([np.cos(facing), np.sin(facing)], axis=1)
    return np.column_stack([np.tile(ring, (len(z), 1)), np.repeat(z, len(ring))])


FAR = (0, 0, np.array([[60.0, 0.0, 0.0]] * 100))
"""What gives a scan the reach of a car's LiDAR."""


def cloud(parts: Sequence[tuple[int, int, FloatArray]]) -> LabelledCloud:
    """Of (class, instance, points)."""
    classes = np.concatenate([np.full(len(points), number) for number, _, points in parts])
    instances = np.concatenate([np.full(len(points), instance) for _, instance, points in parts])
    positions = np.concatenate([points for _, _, points in parts])
    return LabelledCloud(positions, classes.astype(np.int64), instances.astype(np.int64))
