"""Drives for the tests: made ones, and KITTI 00 where it is there."""

import numpy as np

from slam.common.arrays import FloatArray, IntArray
from slam.common.geometry import transform_from_xyz_yaw
from slam.evaluation.inputs.synchronization import PoseSeries, clean_poses
from tests.helpers.data import KITTI

START_NS = 1_700_000_000_000_000_000


def stamps(count: int, rate_hz: float = 10.0) -> IntArray:
    return START_NS + np.round(np.arange(count) * 1e9 / rate_hz).astype(np.int64)


def winding_path(count: int) -> FloatArray:
    """Poses (N, 4, 4) every metre along a path that winds in x, y and z."""
    s = np.arange(float(count))
    yaw = 0.8 * np.sin(s / 60.0)
    xyz = np.stack([np.cumsum(np.cos(yaw)), np.cumsum(np.sin(yaw)), 2.0 * np.sin(s / 90.0)], axis=1)
    return transform_from_xyz_yaw(xyz, yaw)


def straight_path(count: int, step_m: float = 1.0) -> FloatArray:
    return transform_from_xyz_yaw(np.outer(step_m * np.arange(count), [1.0, 0.0, 0.0]), 0.0)


def series(T_world_body: FloatArray, rate_hz: float = 10.0) -> PoseSeries:
    return clean_poses(stamps(len(T_world_body), rate_hz), T_world_body)


def kitti_poses(name: str) -> FloatArray:
    rows = np.loadtxt(KITTI / name).reshape(-1, 3, 4)
    T = np.tile(np.eye(4), (len(rows), 1, 1))
    T[:, :3] = rows
    return T
