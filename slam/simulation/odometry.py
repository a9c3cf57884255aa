"""Odometry that drifts: an error of scale and an error of heading that both walk at random with the path."""

from __future__ import annotations

import numpy as np

from slam.common.arrays import FloatArray
from slam.common.geometry import invert, transform_from_xyz_yaw, yaw_rad
from slam.simulation.config import OdometryConfig

REFERENCE_PATH_M = 100.0


def drifting_odometry(T_world_body: FloatArray, config: OdometryConfig, *, rng: np.random.Generator) -> FloatArray:
    """Odometry ``T_odom_body`` (K, 4, 4), metres, of the true planar poses ``T_world_body`` (K, 4, 4); K >= 1.

    It starts at the identity. Of each true step with path length d, turn a and translation t in the frame of the pose
    that it leaves, the odometry measures the turn ``a + n`` and the translation ``(1 + e) t``, and adds these up:

    * n ~ N(0, sigma_h^2 d / 100 m), independent: the heading error is a random walk, its rms after 100 m of path is
      sigma_h = ``heading_drift_deg_per_100m``, and it grows with the root of the path.
    * e is a stationary Gauss-Markov process over the path with the correlation exp(-s / c), c =
      ``scale_correlation_m``: the error of length, the integral of e, is a random walk over distances well above c, and
      smooth below. Its standard deviation is set so that the rms error of length over 100 m of path is p =
      ``scale_drift_percent`` of it: ``Var = sigma_e^2 2 c^2 (L/c - 1 + exp(-L/c)) = (p L)^2`` at L = 100 m. With c = 0
      the errors of length of the steps are independent, N(0, (p L)^2 d / L).

    On a straight 100 m the heading's walk adds a lateral rms of 100 m times sigma_h / sqrt(3), 0.5 m by default.
    While the body stands, or turns on the spot, nothing drifts. z, roll and pitch have no error.
    """
    step = invert(T_world_body[:-1]) @ T_world_body[1:]  # (K - 1, 4, 4) T_previous_next
    path_m = np.linalg.norm(step[:, :3, 3], axis=1)
    # Both streams are always drawn, so that one drift does not change with the other's setting.
    heading_normals, scale_normals = rng.standard_normal((2, len(step)))
    sigma_heading = np.deg2rad(config.heading_drift_deg_per_100m)
    turn = yaw_rad(step) + heading_normals * sigma_heading * np.sqrt(path_m / REFERENCE_PATH_M)
    translation = step[:, :2, 3] + step[:, :2, 3] * _scale_errors(path_m, scale_normals, config)[:, None]
    heading = np.concatenate([[0.0], np.cumsum(turn)])  # (K,)
    c, s = np.cos(heading[:-1]), np.sin(heading[:-1])
    moved = np.stack(
        [c * translation[:, 0] - s * translation[:, 1], s * translation[:, 0] + c * translation[:, 1]], axis=1
    )
    xyz = np.zeros((len(T_world_body), 3))
    xyz[1:, :2] = np.cumsum(moved, axis=0)
    return transform_from_xyz_yaw(xyz, heading)


def _scale_errors(path_m: FloatArray, normals: FloatArray, config: OdometryConfig) -> FloatArray:
    length_error_m = 0.01 * config.scale_drift_percent * REFERENCE_PATH_M
    c = config.scale_correlation_m
    if c == 0.0:
        moving = np.where(path_m > 0.0, path_m, 1.0)
        white: FloatArray = normals * length_error_m / np.sqrt(REFERENCE_PATH_M * moving)
        return white
    sigma = length_error_m / np.sqrt(2.0 * c**2 * (REFERENCE_PATH_M / c + np.expm1(-REFERENCE_PATH_M / c)))
    kept = np.exp(-path_m / c)
    fresh = np.sqrt(-np.expm1(-2.0 * path_m / c)) * normals
    errors = np.empty(len(path_m))
    for i in range(len(path_m)):
        errors[i] = normals[0] if i == 0 else kept[i] * errors[i - 1] + fresh[i]
    return np.asarray(sigma * errors)
