"""Trajectories in the text formats of others: TUM, KITTI, EuRoC, and CSV with named columns."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from scipy.spatial.transform import Rotation

from logs.errors import DatasetError
from logs.importers.kitti import body_poses, parse_calibration, parse_poses, read_times
from logs.importers.stamps import UNIT_REMEDY, Stamps, read_stamps
from logs.importers.tables import LENGTH_UNITS, Table, read_rows, read_table
from logs.importers.text_files import SourceText
from logs.messages import FloatArray
from logs.validation import MAX_COORDINATE_M, QUATERNION_NORM_TOLERANCE

MAX_STEP_S = 20.0
"""A longer median step is not that of an odometry: a replay takes every such gap for a break (odometry.max_gap_s)."""

MIN_STEP_S = 1e-6
"""A shorter median step is not that of a sensor."""

MAX_SPEED_MPS = 100.0
"""A faster body, by the median, is no robot on the ground; a replay takes steps faster than 60 m/s for jumps."""

_TUM = ("stamp", "x", "y", "z", "qx", "qy", "qz", "qw")
_EUROC = ("stamp_ns", "x", "y", "z", "qw", "qx", "qy", "qz")
_EUROC_NAME = "p_rs_r_x"
_ANGLE_UNITS = {"": 1.0, "rad": 1.0, "deg": np.pi / 180.0}


class TrajectoryFormat(StrEnum):
    """How a trajectory is written.

    TUM: ``stamp_s x y z qx qy qz qw``. KITTI: 12 numbers, the rows of a 3x4 pose, times apart. EuRoC: CSV of
    ``stamp_ns, x, y, z, qw, qx, qy, qz``, further columns are ignored. CSV: a header names stamp, x, y, z and
    qx, qy, qz, qw or yaw (radians; yaw_deg: degrees).
    """

    TUM = "tum"
    KITTI = "kitti"
    EUROC = "euroc"
    CSV = "csv"


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Poses (N, 4, 4) of the body, metres, at strictly increasing ``stamps``; ``lines`` (N,) of the file ``name``."""

    name: str
    lines: Sequence[int]
    stamps: Stamps
    T_world_body: FloatArray
    format: TrajectoryFormat

    def poses(self) -> Iterator[tuple[int, FloatArray]]:
        """Stamp [ns] and pose (4, 4) of each."""
        return zip(self.stamps.stamps_ns.tolist(), self.T_world_body, strict=True)

    @property
    def length_m(self) -> float:
        """Length of the path."""
        return float(_steps_m(self.T_world_body).sum())


def read_trajectory(
    source: SourceText, *, times: SourceText | None = None, calib: SourceText | None = None
) -> Trajectory:
    """The trajectory in ``source``, in the format that it is found to have.

    Args:
        source: the file.
        times: seconds of each pose, one a line; only for KITTI's format, which has none.
        calib: KITTI's calibration, if the poses in KITTI's format are of the left camera: the body is then the
            velodyne, and the poses are given in its frame at the origin.

    Raises:
        DatasetError: a file is wrong, the stamps do not increase, or stamps or positions are in an impossible unit.
    """
    format = find_format(source)
    if format == TrajectoryFormat.KITTI:
        trajectory = _read_kitti(source, times, calib)
    else:
        table = _pose_table(source, format)
        stamps = read_stamps(table)
        stamps.check_increasing(strictly=True)
        trajectory = Trajectory(source.name, list(table.cells.index), stamps, _poses(table), format)
    _check_plausible(trajectory)
    return trajectory


def find_format(source: SourceText) -> TrajectoryFormat:
    """The format that the content has.

    Raises:
        DatasetError: it fits none.
    """
    if source.text.lstrip().startswith("{"):
        return TrajectoryFormat.CSV
    rows = read_rows(source)
    if rows.header is not None:
        is_euroc = any(_EUROC_NAME in name.lower() for name in rows.header)
        return TrajectoryFormat.EUROC if is_euroc else TrajectoryFormat.CSV
    width, is_csv = len(rows.cells[0]), rows.delimiter != " "
    if width == len(_TUM) and (not is_csv or any("." in row[0] for row in rows.cells)):
        return TrajectoryFormat.TUM
    if width >= len(_EUROC) and is_csv:
        return TrajectoryFormat.EUROC
    if width == 12:
        return TrajectoryFormat.KITTI
    raise DatasetError(
        f"{source.name}, line {rows.lines[0]}: {width} values are not a pose; expected 8 "
        "(TUM: stamp x y z qx qy qz qw), 12 (KITTI: 3x4), CSV of EuRoC, or a first line that names the columns "
        "(stamp_s,x_m,y_m,z_m,qx,qy,qz,qw)"
    )


def _pose_table(source: SourceText, format: TrajectoryFormat) -> Table:
    if format == TrajectoryFormat.CSV:
        return read_table(source)
    rows = read_rows(source)
    if format == TrajectoryFormat.TUM:
        return rows.table(_TUM)
    return replace(rows, cells=[row[: len(_EUROC)] for row in rows.cells]).table(_EUROC)


def _poses(table: Table) -> FloatArray:
    T = np.tile(np.eye(4), (len(table.cells), 1, 1))
    for i, name in enumerate("xyz"):
        column = table.find((name, f"position_{name}", f"p{name}", f"t{name}"), LENGTH_UNITS)
        if column is not None:
            T[:, i, 3] = table.numbers(column, LENGTH_UNITS)
            too_far = np.abs(T[:, i, 3]) > MAX_COORDINATE_M
            table.refuse(too_far, column, "CELL m is too far away; correct it, or remove the line")
        elif name != "z":
            table.need(f"{name} in metres", f"{name}_m", (name,), LENGTH_UNITS)
    T[:, :3, :3] = _rotations(table)
    return T


def _rotations(table: Table) -> FloatArray:
    yaw = table.find(("yaw", "heading", "theta"), _ANGLE_UNITS)
    if yaw is not None and table.find(("qw",)) is None:
        yaw_rad = table.numbers(yaw, _ANGLE_UNITS)
        # Headings that are wrapped lie within one turn, and others change by less from pose to pose.
        jumps_rad = np.abs(np.diff(yaw_rad, prepend=yaw_rad[:1])) * (yaw.unit != "deg")
        fault = f"the heading changes by {jumps_rad.max():.4g} rad from the pose before, more than a whole turn"
        table.refuse(jumps_rad > 2.0 * np.pi, yaw, f"{fault}; if these are degrees, call the column yaw_deg")
        return np.asarray(Rotation.from_euler("z", yaw_rad[:, None]).as_matrix())
    columns = [table.need(f"the quaternion's {q}", q, (q, f"orientation_{q[1]}")) for q in ("qx", "qy", "qz", "qw")]
    q_xyzw = np.stack([table.numbers(column) for column in columns], axis=1)
    norms = np.linalg.norm(q_xyzw, axis=1)
    wrong = np.abs(norms - 1.0) > QUATERNION_NORM_TOLERANCE
    if wrong.any():
        row = int(wrong.argmax())
        fault = f"a quaternion of norm {norms[row]:.4g} is not a rotation; its norm must be 1"
        raise table.error(row, " ".join(column.name for column in columns), fault)
    return np.asarray(Rotation.from_quat(q_xyzw).as_matrix())


def _read_kitti(source: SourceText, times: SourceText | None, calib: SourceText | None) -> Trajectory:
    if times is None:
        raise DatasetError(
            f"{source.name}: poses in KITTI's format have no stamps; give the file of their times (--times)"
        )
    T = parse_poses(source)
    stamps = read_times(times)
    if len(T) != len(stamps.stamps_ns):
        raise DatasetError(
            f"{source.name} has {len(T)} poses, {times.name} {len(stamps.stamps_ns)} times; give files of one drive"
        )
    if calib is not None:
        T = body_poses(T, parse_calibration(calib))
    return Trajectory(source.name, [line for line, _ in source.lines()], stamps, T, TrajectoryFormat.KITTI)


def _check_plausible(trajectory: Trajectory) -> None:
    """See that the median step takes a time and a speed that a robot on the ground has."""
    stamps = trajectory.stamps
    if len(stamps.stamps_ns) < 2:
        raise DatasetError(f"{trajectory.name}: one pose only; a drive has at least two")
    steps_s = np.diff(stamps.stamps_ns) * 1e-9
    if not MIN_STEP_S <= np.median(steps_s) <= MAX_STEP_S:
        fault = f"poses are {np.median(steps_s):.3g} s apart (median), unlike those of any odometry"
        raise stamps.table.error(1, stamps.column.name, f"{fault}; give the stamps in seconds, or {UNIT_REMEDY}")
    steps_m = _steps_m(trajectory.T_world_body)
    speeds_mps = steps_m[steps_m > 0.0] / steps_s[steps_m > 0.0]
    if len(speeds_mps) and np.median(speeds_mps) > MAX_SPEED_MPS:
        raise DatasetError(
            f"{trajectory.name}, line {trajectory.lines[int((steps_m > 0.0).argmax()) + 1]}, columns x y z: the body "
            f"moves at {np.median(speeds_mps):.4g} m/s (median); positions are metres: divide them by 1000 if these "
            "are millimetres, and see that the stamps are right"
        )


def _steps_m(T: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1), dtype=np.float64)
