"""Trajectories in text files: TUM, KITTI, and tables with named columns."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from logs.errors import DatasetError
from logs.importers.tables import LENGTH_UNITS, UNIT_REMEDY, Table, first_row, is_number, read_table
from logs.importers.text_files import SourceText
from logs.messages import FloatArray, IntArray
from logs.records import frozen
from logs.validation import MAX_COORDINATE_M, QUATERNION_NORM_TOLERANCE, ROTATION_TOLERANCE, rotation_errors

_KITTI = [f"T{row}{column}" for row in range(3) for column in range(4)]
"""The rows of a 3x4 pose, one after another."""
_TUM = ("stamp_s", "x", "y", "z", "qx", "qy", "qz", "qw")
_ANGLE_UNITS = {"": 1.0, "rad": 1.0, "deg": np.pi / 180.0}


TrajectoryFormat = Literal["tum", "kitti", "csv"]
"""How a trajectory is written.

TUM: ``stamp_s x y z qx qy qz qw``. KITTI: 12 numbers, the rows of a 3x4 pose, times apart. CSV: a header names
stamp, x, y, z and qx, qy, qz, qw or yaw (radians; yaw_deg: degrees).
"""


@frozen
class Trajectory:
    """Poses (N, 4, 4) of the body, metres, at strictly increasing stamps (N,)."""

    stamps_ns: IntArray
    T_world_body: FloatArray
    format: TrajectoryFormat

    def poses(self) -> Iterator[tuple[int, FloatArray]]:
        """Stamp [ns] and pose (4, 4) of each."""
        return zip(self.stamps_ns.tolist(), self.T_world_body, strict=True)

    @property
    def length_m(self) -> float:
        """Length of the path."""
        return float(_steps_m(self.T_world_body).sum())


def read_trajectory(
    source: SourceText, *, times_ns: IntArray | None = None, calib: SourceText | None = None
) -> Trajectory:
    """The trajectory in ``source``, in the format that it is found to have.

    Args:
        source: the file.
        times_ns: increasing stamps of the poses; only for KITTI's format, which has none.
        calib: KITTI's calibration, if the poses in KITTI's format are of the left camera: the body is then the
            velodyne, and the poses are given in its frame at the origin.

    Raises:
        DatasetError: a file is wrong, the stamps do not increase, or stamps or positions are in an impossible unit.
    """
    format = _find_format(source)
    if format == "kitti":
        trajectory = _read_kitti(source, times_ns, calib)
    else:
        table = read_table(source, _TUM if format == "tum" else ())
        trajectory = Trajectory(table.stamps(strictly=True), _poses(table), format)
    _check_plausible(source.name, trajectory)
    return trajectory


def _find_format(source: SourceText) -> TrajectoryFormat:
    """The format that the content has.

    Raises:
        DatasetError: it fits none.
    """
    row = first_row(source)
    if not is_number(row[0]):
        return "csv"
    if len(row) == len(_TUM):
        return "tum"
    if len(row) != len(_KITTI):
        raise DatasetError(
            f"{source.name}: {len(row)} values are not a pose; expected 8 (TUM: stamp x y z qx qy qz qw), 12 (KITTI: "
            "3x4), or a first line that names the columns (stamp_s,x_m,y_m,z_m,qx,qy,qz,qw)"
        )
    return "kitti"


def _poses(table: Table) -> FloatArray:
    T = np.tile(np.eye(4), (len(table.lines), 1, 1))
    for i, axis in enumerate("xyz"):
        names = (axis, f"t{axis}")
        if axis == "z" and table.find(names, LENGTH_UNITS) is None:
            continue
        column = table.need(f"{axis} in metres", f"{axis}_m", names, LENGTH_UNITS)
        T[:, i, 3] = column.numbers()
        too_far = np.abs(T[:, i, 3]) > MAX_COORDINATE_M
        column.refuse(too_far, "CELL m is too far away; correct it, or remove the line")
    T[:, :3, :3] = _rotations(table)
    return T


def _rotations(table: Table) -> FloatArray:
    yaw = table.find(("yaw", "theta"), _ANGLE_UNITS)
    if yaw is not None:
        yaw_rad = yaw.numbers()
        # Headings that are wrapped lie within one turn, and others change by less from pose to pose.
        jumps = np.abs(np.diff(yaw_rad, prepend=yaw_rad[:1])) > 2.0 * np.pi
        yaw.refuse(
            jumps,
            "CELL differs from the heading before by more than a turn; if these are degrees, name the column yaw_deg",
        )
        return Rotation.from_euler("z", yaw_rad[:, None]).as_matrix()
    columns = [*filter(None, (table.find((name,)) for name in _TUM[4:]))]
    if len(columns) < 4:
        raise DatasetError(
            f"{table.name}: no rotation among {', '.join(table.columns)}; give yaw (radians from x to y), yaw_deg, or "
            "qx, qy, qz and qw"
        )
    q_xyzw = np.stack([column.numbers() for column in columns], axis=1)
    norms = np.linalg.norm(q_xyzw, axis=1)
    wrong = np.abs(norms - 1.0) > QUATERNION_NORM_TOLERANCE
    columns[-1].refuse(wrong, "the norm of the quaternion is not 1, so it is no rotation")
    return Rotation.from_quat(q_xyzw).as_matrix()


def _read_kitti(source: SourceText, times_ns: IntArray | None, calib: SourceText | None) -> Trajectory:
    if times_ns is None:
        raise DatasetError(
            f"{source.name}: poses in KITTI's format have no stamps; give the file of their times (--times)"
        )
    T = _parse_poses(source)
    if len(T) != len(times_ns):
        raise DatasetError(
            f"{source.name} has {len(T)} poses without stamps, and there are {len(times_ns)} times; give one for each"
        )
    if calib is not None:
        # The origin is the first pose of the camera, so the velodyne starts at the identity: x forward, y left, z up.
        T_camera_velodyne = _parse_calibration(calib)
        T = np.linalg.inv(T_camera_velodyne) @ T @ T_camera_velodyne
    return Trajectory(times_ns, T, "kitti")


def _parse_poses(source: SourceText) -> FloatArray:
    """Poses (N, 4, 4) of the left camera, metres, of the odometry benchmark: a line of 12 numbers (3x4, row-major).

    Rotations are made orthonormal by SVD.

    Raises:
        DatasetError: a line that is no 12 finite numbers, or no rigid transform.
    """
    table = read_table(source, _KITTI)
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
    U, _, Vt = np.linalg.svd(T[:, :3, :3])
    T[:, :3, :3] = U @ Vt  # the nearest rotations
    return T


def _parse_calibration(source: SourceText) -> FloatArray:
    """``T_camera_velodyne`` (4, 4), metres, from the line ``Tr:`` of a KITTI odometry calibration.

    Raises:
        DatasetError: no such line, or not a rigid transform.
    """
    lines = [line.partition(":")[2] if line.startswith("Tr:") else "" for line in source.text.splitlines()]
    T = _parse_poses(replace(source, text="\n".join(lines)))
    if not len(T):
        raise DatasetError(f"{source.name}: no line 'Tr:' (velodyne to left camera); give the sequence's calib.txt")
    return T[0]


def _check_plausible(name: str, trajectory: Trajectory) -> None:
    """See that the median step takes a time and a speed that a robot on the ground has."""
    if len(trajectory.stamps_ns) < 2:
        raise DatasetError(f"{name}: one pose only; a drive has at least two")
    steps_s = np.diff(trajectory.stamps_ns) * 1e-9
    step_s = np.median(steps_s)
    # No steps of a sensor, or none of an odometry: a replay takes every such gap for a break.
    if not 1e-6 <= step_s <= 20.0:
        raise DatasetError(
            f"{name}: poses are {step_s:.3g} s apart (median), unlike those of any odometry; give the "
            f"stamps in seconds, or {UNIT_REMEDY}"
        )
    steps_m = _steps_m(trajectory.T_world_body)
    speeds_mps = (steps_m / steps_s)[steps_m > 0.0]
    # No robot on the ground.
    if len(speeds_mps) and np.median(speeds_mps) > 100.0:
        raise DatasetError(
            f"{name}: the body moves at {np.median(speeds_mps):.4g} m/s (median); positions are metres: divide them by "
            "1000 if these are millimetres, and check the stamps"
        )


def _steps_m(T: FloatArray) -> FloatArray:
    return np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1)
