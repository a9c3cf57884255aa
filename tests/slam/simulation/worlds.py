"""Small worlds for the tests."""

from __future__ import annotations

import numpy as np

from slam.common.geometry import transform_from_xyz_yaw
from slam.simulation.world import World


def straight_street(heading_rad: float = 0.0) -> World:
    """Objects every 5 m on both sides, 6 m from a tour from the origin straight towards ``heading_rad``."""
    x = np.arange(0.0, 200.0, 5.0)
    positions = np.concatenate([np.stack([x, np.full_like(x, y), np.zeros_like(x)], axis=1) for y in (-6.0, 6.0)])
    ids = tuple(f"object-{i}" for i in range(len(positions)))
    classes = ("bench", "lamp", "tree")
    labels = tuple(classes[i % len(classes)] for i in range(len(positions)))
    R = transform_from_xyz_yaw(np.zeros(3), heading_rad)[:3, :3]
    tour = np.array([[0.0, 0.0], [200.0, 0.0]]) @ R[:2, :2].T
    return World("street", ids, positions @ R.T, labels, tour)
