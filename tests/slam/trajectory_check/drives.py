"""Drives through a field of objects, with the true poses and worse ones."""

import numpy as np

from slam.common.arrays import FloatArray
from slam.common.geometry import apply, invert, transform_from_xyz_yaw, travelled_m
from slam.trajectory_check.prediction import SampledScan

RANGE_M = 20.0
SIGMA_M = 0.2
SCANS = 240
UPRIGHT = np.eye(4)


def circle(*, rounds: float = 2.0) -> FloatArray:
    """True poses (SCANS, 4, 4) on a circle that is much larger than the sensor range."""
    angles = np.linspace(0.0, 2.0 * np.pi * rounds, SCANS)
    xyz = 100.0 * np.stack([np.cos(angles), np.sin(angles), np.zeros(SCANS)], axis=1)
    return transform_from_xyz_yaw(xyz, angles + 0.5 * np.pi)


def drifting(T_true: FloatArray, drift_m: float) -> FloatArray:
    """The same poses, moved steadily up to ``drift_m`` at the end."""
    T = T_true.copy()
    T[:, 0, 3] += np.linspace(0.0, drift_m, len(T))
    return T


def scans_of(T_true: FloatArray, *, T_body_sensor: FloatArray = UPRIGHT) -> tuple[SampledScan, ...]:
    """What a body sees of objects at random, with noise, in axes that ``T_body_sensor`` (4, 4) turns."""
    rng = np.random.default_rng(5)
    objects = np.column_stack([rng.uniform(-130.0, 130.0, (800, 2)), rng.uniform(0.0, 0.5, 800)])
    labels = rng.integers(0, 3, len(objects))
    travel_m = travelled_m(T_true[:, :3, 3])
    scans = []
    for k, T in enumerate(T_true):
        seen = apply(invert(T), objects)
        near = np.linalg.norm(seen, axis=1) < RANGE_M
        positions = seen[near] + rng.normal(0.0, SIGMA_M, (int(near.sum()), 3))
        positions = apply(invert(T_body_sensor), positions)
        scans.append(SampledScan(k, positions, labels[near], float(travel_m[k]), T, T))
    return tuple(scans)
