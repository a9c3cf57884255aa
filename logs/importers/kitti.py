"""The text files of the KITTI odometry benchmark: camera poses, and the calibration of the LiDAR."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from logs.errors import DatasetError
from logs.importers.tables import read_table
from logs.importers.text_files import SourceText
from logs.messages import FloatArray
from logs.validation import MAX_COORDINATE_M, ROTATION_TOLERANCE, nearest_rotations, rotation_errors

POSE_COLUMNS = [f"T{row}{column}" for row in range(3) for column in range(4)]
"""The rows of a 3x4 pose, one after another."""


def parse_poses(source: SourceText) -> FloatArray:
    """Poses (N, 4, 4) of the left camera in the frame of the file, metres: a line of 12 numbers (3x4, row-major) each.

    Rotations are made orthonormal by SVD.

    Raises:
        DatasetError: a line that is no 12 finite numbers, or no rigid transform.
    """
    table = read_table(source, POSE_COLUMNS)
    T = np.tile(np.eye(4), (len(table.lines), 1, 1))
    T[:, :3] = table.matrix().reshape(-1, 3, 4)
    errors = rotation_errors(T[:, :3, :3])
    wrong = (errors > ROTATION_TOLERANCE) | (np.abs(T[:, :3, 3]) > MAX_COORDINATE_M).any(axis=1)
    if wrong.any():
        row = int(wrong.argmax())
        raise DatasetError(
            f"{source.name}, line {table.lines[row]}: not a rotation (|R^T R - I| = {errors[row]:.3g}), or farther "
            f"away than {MAX_COORDINATE_M:g} m; expected a 3x4 pose, row-major"
        )
    T[:, :3, :3] = nearest_rotations(T[:, :3, :3])
    return T


def parse_calibration(source: SourceText) -> FloatArray:
    """``T_camera_velodyne`` (4, 4), metres, from the line ``Tr:`` of a KITTI odometry calibration.

    Raises:
        DatasetError: no such line, or not a rigid transform.
    """
    lines = [line.partition(":")[2] if line.startswith("Tr:") else "" for line in source.text.splitlines()]
    T = parse_poses(replace(source, text="\n".join(lines)))
    if not len(T):
        raise DatasetError(f"{source.name}: no line 'Tr:' (velodyne to left camera); give the sequence's calib.txt")
    return np.asarray(T[0])


def body_poses(T_origin_camera: FloatArray, T_camera_velodyne: FloatArray) -> FloatArray:
    """Poses (N, 4, 4) of the velodyne in the velodyne frame that belongs to the origin of the camera poses (N, 4, 4).

    KITTI's origin is the first camera pose, so the result starts at the identity: x forward, y left, z up.
    """
    T_velodyne_camera = np.linalg.inv(T_camera_velodyne)
    return np.asarray(T_velodyne_camera @ T_origin_camera @ T_camera_velodyne, dtype=np.float64)
