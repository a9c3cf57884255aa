"""KITTI odometry text files: camera poses, scan times and the calibration between LiDAR and camera."""

from __future__ import annotations

from decimal import Decimal, InvalidOperation

import numpy as np

from logs.errors import DatasetError
from logs.importers.text_files import TextFile, parse_numbers
from logs.messages import FloatArray
from logs.validation import LARGEST_M

ROTATION_TOLERANCE = 1e-3
"""Largest |R^T R - I| of a rotation that is taken for rounding (the files have 7 digits) and not for damage."""

LARGEST_STAMP_NS = 2**63 - 1


def parse_poses(file: TextFile) -> FloatArray:
    """Poses (N, 4, 4) of the left camera in the frame of the file, metres: a line of 12 numbers (3x4, row-major) each.

    Rotations are made orthonormal by SVD.

    Raises:
        DatasetError: a line that is no 12 finite numbers, or whose rotation is none.
    """
    numbers: list[int] = []
    rows: list[list[float]] = []
    for number, line in file.lines():
        numbers.append(number)
        rows.append(parse_numbers(file.name, number, line.split(), 12))
    return _rigid_transforms(file.name, numbers, rows)


def parse_calibration(file: TextFile) -> FloatArray:
    """``T_camera_velodyne`` (4, 4), metres, from the line ``Tr:`` of a KITTI odometry calibration.

    Raises:
        DatasetError: no such line, or not a rigid transform.
    """
    for number, line in file.lines():
        key, _, values = line.partition(":")
        if key.strip() == "Tr":
            row = parse_numbers(file.name, number, values.split(), 12)
            T_camera_velodyne: FloatArray = _rigid_transforms(file.name, [number], [row])[0]
            return T_camera_velodyne
    raise DatasetError(f"{file.name}: no line 'Tr:' (velodyne to left camera); give the sequence's calib.txt")


def parse_times(file: TextFile) -> list[int]:
    """Stamps in integer nanoseconds, from one line of seconds each; the decimal text is converted exactly.

    Raises:
        DatasetError: a line that is no time, or does not come after the one before.
    """
    stamps_ns: list[int] = []
    for number, line in file.lines():
        try:
            seconds = Decimal(line)
        except InvalidOperation as error:
            raise DatasetError(f"{file.name}, line {number}: {line!r} is not a time in seconds") from error
        if not seconds.is_finite() or not 0 <= seconds <= LARGEST_STAMP_NS // 10**9:
            raise DatasetError(f"{file.name}, line {number}: {line!r} is not a time in seconds from 0 on")
        stamp_ns = int((seconds * 10**9).to_integral_value())
        if stamps_ns and stamp_ns <= stamps_ns[-1]:
            raise DatasetError(
                f"{file.name}, line {number}: time {line} s does not come after the one before "
                f"({stamps_ns[-1]} ns); times must increase"
            )
        stamps_ns.append(stamp_ns)
    return stamps_ns


def body_poses(T_origin_camera: FloatArray, T_camera_velodyne: FloatArray) -> FloatArray:
    """Poses (N, 4, 4) of the velodyne in the velodyne frame that belongs to the origin of the camera poses (N, 4, 4).

    KITTI's origin is the first camera pose, so the result starts at the identity: x forward, y left, z up.
    """
    T_velodyne_camera = np.linalg.inv(T_camera_velodyne)
    return np.asarray(T_velodyne_camera @ T_origin_camera @ T_camera_velodyne, dtype=np.float64)


def _rigid_transforms(name: str, numbers: list[int], rows: list[list[float]]) -> FloatArray:
    T = np.tile(np.eye(4), (len(rows), 1, 1))
    T[:, :3] = np.asarray(rows, dtype=np.float64).reshape(-1, 3, 4)
    R = T[:, :3, :3]
    with np.errstate(over="ignore", invalid="ignore"):
        error = np.abs(np.swapaxes(R, -1, -2) @ R - np.eye(3)).max(axis=(1, 2), initial=0.0)
        determinant = np.linalg.det(R)
    wrong = ~(error <= ROTATION_TOLERANCE) | ~(determinant > 0.0)
    if np.any(wrong):
        i = int(np.argmax(wrong))
        raise DatasetError(
            f"{name}, line {numbers[i]}: not a rotation (|R^T R - I| = {error[i]:.3g}, allowed {ROTATION_TOLERANCE:g}; "
            f"det R = {determinant[i]:.3g}); expected a 3x4 pose, row-major"
        )
    far = (np.abs(T[:, :3, 3]) > LARGEST_M).any(axis=1)
    if far.any():
        i = int(far.argmax())
        raise DatasetError(f"{name}, line {numbers[i]}: {T[i, :3, 3]} m is no place; correct it, or leave the line out")
    U, _, Vt = np.linalg.svd(R)
    T[:, :3, :3] = U @ Vt
    return T
