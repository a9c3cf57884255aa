"""Trajectories in the text formats of others: TUM, KITTI, EuRoC, and CSV with named columns."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from scipy.spatial.transform import Rotation

from logs.errors import DatasetError
from logs.importers.kitti import body_poses, parse_calibration, parse_poses, read_times
from logs.importers.stamps import Stamps, read_stamps
from logs.importers.tables import LENGTH_UNITS, Table, header_above, read_table, table_of_rows
from logs.importers.text_files import SourceText, is_number
from logs.messages import FloatArray
from logs.validation import MAX_COORDINATE_M, QUATERNION_NORM_TOLERANCE

MAX_STEP_S = 20.0
"""A longer median step is not that of an odometry: a replay takes every such gap for a break (odometry.max_gap_s)."""

MIN_STEP_S = 1e-6
"""A shorter median step is not that of a sensor."""

MAX_SPEED_MPS = 100.0
"""A faster body, by the median, is no robot on the ground; a replay takes steps faster than 60 m/s for jumps."""

_COLUMNS = {
    "tum": ("stamp", "x", "y", "z", "qx", "qy", "qz", "qw"),
    "euroc": ("stamp_ns", "x", "y", "z", "qw", "qx", "qy", "qz"),
}
_EUROC_NAME = "p_rs_r_x"
_SEPARATORS = re.compile(r"\s*[,;]\s*|\s+")
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
    source: SourceText,
    *,
    times: SourceText | None = None,
    calib: SourceText | None = None,
    format: TrajectoryFormat | None = None,
) -> Trajectory:
    """The trajectory in ``source``, in the format that it is found to have or that is given.

    Args:
        source: the file.
        times: seconds of each pose, one a line; only for KITTI's format, which has none.
        calib: KITTI's calibration, if the poses in KITTI's format are of the left camera: the body is then the
            velodyne, and the poses are given in its frame at the origin.
        format: for a file whose content leaves it open.

    Raises:
        DatasetError: a file is wrong, the stamps do not increase, or stamps or positions are in an impossible unit.
    """
    chosen = format or find_format(source)
    if chosen == TrajectoryFormat.KITTI:
        trajectory = _read_kitti(source, times, calib)
    else:
        table = _pose_table(source, chosen)
        stamps = read_stamps(table)
        stamps.check_increasing(strictly=True)
        trajectory = Trajectory(source.name, table.lines, stamps, _poses(table), chosen)
    _check_steps(trajectory)
    _check_speed(trajectory)
    return trajectory


def find_format(source: SourceText) -> TrajectoryFormat:
    """The format that the content has.

    Raises:
        DatasetError: it fits none.
    """
    line, first = next(iter(source.lines()), (0, ""))
    fields = _SEPARATORS.split(first)
    header = header_above(source, line) if "," in first or ";" in first else None
    if first.startswith("{") or (len(fields) >= len("txy") and not is_number(fields[0])):
        header = first
    if header is not None:
        return TrajectoryFormat.EUROC if _EUROC_NAME in header.lower() else TrajectoryFormat.CSV
    if len(fields) == 8 and ("," not in first or _has_fractions(source)):
        return TrajectoryFormat.TUM
    if "," in first and len(fields) >= 8:
        return TrajectoryFormat.EUROC
    if len(fields) == 12 and "," not in first:
        return TrajectoryFormat.KITTI
    raise DatasetError(
        f"{source.name}, line {line}: {len(fields) if first else 0} values ({first[:40]!r}) are not a pose; expected 8 "
        "(TUM: stamp x y z qx qy qz qw), 12 (KITTI: 3x4), CSV of EuRoC, or a first line that names the columns "
        "(stamp_s,x_m,y_m,z_m,qx,qy,qz,qw)"
    )


def _has_fractions(source: SourceText) -> bool:
    """Whether the stamps, which come first, are seconds with digits behind the point and not EuRoC's nanoseconds."""
    return any("." in _SEPARATORS.split(line)[0] for _, line in source.lines())


def _pose_table(source: SourceText, format: TrajectoryFormat) -> Table:
    names = _COLUMNS.get(format)
    if names is None:
        return read_table(source)
    rows = [(i, _SEPARATORS.split(line)) for i, line in source.lines() if _EUROC_NAME not in line.lower()]
    count = len(names) if format == TrajectoryFormat.EUROC else None
    table = table_of_rows(source, names, ((i, row[:count]) for i, row in rows))
    if not table.lines:
        raise DatasetError(f"{source.name}: no pose in it")
    return table


def _poses(table: Table) -> FloatArray:
    latitude = table.find(("latitude", "lat"), ("", "deg"))
    if latitude is not None:
        raise DatasetError(
            f"{table.name}: column {latitude.name}: poses are read in metres; project them to a plane (for example "
            "UTM), and call the columns x_m, y_m and z_m"
        )
    T = np.tile(np.eye(4), (len(table.lines), 1, 1))
    for i, name in enumerate("xyz"):
        column = table.find((name, f"position_{name}", f"p{name}", f"t{name}"), LENGTH_UNITS)
        if column is not None:
            T[:, i, 3] = table.numbers(column, LENGTH_UNITS)
            too_far = np.abs(T[:, i, 3]) > MAX_COORDINATE_M
            table.refuse(too_far, column, "CELL m is not finite or too far away; correct it, or remove the line")
        elif name != "z":
            table.need(name, f"{name}_m", (name,), LENGTH_UNITS)
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


def _check_steps(trajectory: Trajectory) -> None:
    stamps = trajectory.stamps
    if len(stamps.stamps_ns) < 2:
        raise DatasetError(f"{trajectory.name}: one pose only; a drive has at least two")
    median_s = float(np.median(np.diff(stamps.stamps_ns))) * 1e-9
    if not MIN_STEP_S <= median_s <= MAX_STEP_S:
        raise stamps.table.error(
            1,
            stamps.column,
            f"poses are {median_s:.3g} s apart (median), unlike those of any odometry; give the stamps in "
            f"{stamps.unit_name}, or name the columns and call this one by its unit: stamp_s, stamp_ms, stamp_us or "
            "stamp_ns",
        )


def _check_speed(trajectory: Trajectory) -> None:
    moved_m = _steps_m(trajectory.T_world_body)
    moving = np.flatnonzero(moved_m > 0.0)
    speeds_mps = moved_m[moving] / (np.diff(trajectory.stamps.stamps_ns)[moving] * 1e-9)
    if not len(moving) or np.median(speeds_mps) <= MAX_SPEED_MPS:
        return
    line = trajectory.lines[int(moving[np.argmax(speeds_mps > MAX_SPEED_MPS)]) + 1]
    raise DatasetError(
        f"{trajectory.name}, line {line}, columns x y z: the body moves at {np.median(speeds_mps):.4g} m/s (median); "
        "positions are metres: divide them by 1000 if these are millimetres, and see that the stamps are right"
    )


def _steps_m(T: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1), dtype=np.float64)
