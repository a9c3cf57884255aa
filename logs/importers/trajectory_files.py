"""Trajectories in the text formats of others: TUM, KITTI, EuRoC, and CSV with named columns."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from scipy.spatial.transform import Rotation

from logs.errors import DatasetError
from logs.importers.kitti_poses import body_poses, parse_calibration, parse_poses, parse_times
from logs.importers.stamps import Stamps, read_stamps
from logs.importers.tables import LENGTH_UNITS, SourceText, Table, read_table, table_of_rows
from logs.importers.text_files import TextFile
from logs.messages import FloatArray
from logs.validation import QUATERNION_NORM_TOLERANCE

SLOWEST_STEP_S = 20.0
"""A median step longer than that is no odometry: a replay takes every such gap for a break (odometry.max_gap_s)."""

GREATEST_SPEED_MPS = 100.0
"""A median speed beyond it is that of no robot on the ground; a replay takes steps faster than 60 m/s for jumps."""

_TUM = ("stamp", "x", "y", "z", "qx", "qy", "qz", "qw")
_EUROC = ("stamp_ns", "x", "y", "z", "qw", "qx", "qy", "qz")
_QUATERNION = ("qx", "qy", "qz", "qw")


class TrajectoryFormat(StrEnum):
    """How a trajectory is written.

    TUM: ``stamp_s x y z qx qy qz qw``. KITTI: 12 numbers, the rows of a 3x4 pose, times apart. EuRoC: CSV of
    ``stamp_ns, x, y, z, qw, qx, qy, qz``, more columns being passed over. CSV: a header names stamp, x, y, z and
    qx, qy, qz, qw or yaw (radians).
    """

    TUM = "tum"
    KITTI = "kitti"
    EUROC = "euroc"
    CSV = "csv"


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Poses (N, 4, 4) of the body, metres, at strictly increasing ``stamps``."""

    stamps: Stamps
    T_world_body: FloatArray
    format: TrajectoryFormat

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
        trajectory = Trajectory(stamps, _poses(table), chosen)
    _check_units(trajectory)
    return trajectory


def find_format(source: SourceText) -> TrajectoryFormat:
    """The format that the content has.

    Raises:
        DatasetError: it fits none.
    """
    line, first = next(iter(source.lines()), (0, ""))
    fields = first.replace(",", " ").split()
    if "," in first:
        return TrajectoryFormat.EUROC if _are_numbers(fields) else TrajectoryFormat.CSV
    if first.startswith("{"):
        return TrajectoryFormat.CSV
    if len(fields) == len(_TUM) and _are_numbers(fields[:1]):
        return TrajectoryFormat.TUM
    if len(fields) == 12 and _are_numbers(fields[:1]):
        return TrajectoryFormat.KITTI
    raise DatasetError(
        f"{source.name}, line {line}: {len(fields)} values ({first[:40]!r}) are no pose; expected 8 (TUM: stamp x y z "
        "qx qy qz qw), 12 (KITTI: 3x4), CSV of EuRoC, or CSV with a header; say --format if it is one of them"
    )


def _are_numbers(fields: list[str]) -> bool:
    try:
        return all(np.isfinite(float(field)) for field in fields)
    except ValueError:
        return False


def _pose_table(source: SourceText, format: TrajectoryFormat) -> Table:
    if format == TrajectoryFormat.TUM:
        return _some_rows(source, table_of_rows(source, _TUM, ((i, line.split()) for i, line in source.lines())))
    if format == TrajectoryFormat.EUROC:
        rows = ((i, line.split(",")) for i, line in source.lines())
        return _some_rows(source, table_of_rows(source, _EUROC, ((i, row[: len(_EUROC)]) for i, row in rows)))
    return read_table(source)


def _some_rows(source: SourceText, table: Table) -> Table:
    if not table.lines:
        raise DatasetError(f"{source.name}: no pose in it")
    return table


def _poses(table: Table) -> FloatArray:
    T = np.tile(np.eye(4), (len(table.lines), 1, 1))
    for i, name in enumerate("xyz"):
        column = table.find((name, f"position_{name}", f"p{name}", f"t{name}"), LENGTH_UNITS)
        if column is not None:
            T[:, i, 3] = table.numbers(column, LENGTH_UNITS)
        elif name != "z":
            table.need(name, f"{name}_m", (name,), LENGTH_UNITS)
    T[:, :3, :3] = _rotations(table)
    return T


def _rotations(table: Table) -> FloatArray:
    yaw = table.find(("yaw", "heading", "theta"), ("", "rad"))
    if yaw is not None and table.find(("qw",)) is None:
        return np.asarray(Rotation.from_euler("z", table.numbers(yaw, {"": 1.0, "rad": 1.0})).as_matrix())
    columns = [table.need(f"the quaternion's {name}", name, (name, f"orientation_{name[1]}")) for name in _QUATERNION]
    q_xyzw = np.stack([table.numbers(column) for column in columns], axis=1)
    norms = np.linalg.norm(q_xyzw, axis=1)
    wrong = np.abs(norms - 1.0) > QUATERNION_NORM_TOLERANCE
    if wrong.any():
        row = int(np.argmax(wrong))
        raise table.error(
            row,
            " ".join(column.name for column in columns),
            f"a quaternion of norm {norms[row]:.4g} is no rotation; its norm must be 1",
        )
    return np.asarray(Rotation.from_quat(q_xyzw).as_matrix())


def _read_kitti(source: SourceText, times: SourceText | None, calib: SourceText | None) -> Trajectory:
    if times is None:
        raise DatasetError(
            f"{source.name}: poses in KITTI's format have no stamps; give the file of their times (--times)"
        )
    T = parse_poses(_plain_file(source))
    stamps_ns = parse_times(_plain_file(times))
    if len(T) != len(stamps_ns) or not stamps_ns:
        raise DatasetError(
            f"{source.name} has {len(T)} poses, {times.name} {len(stamps_ns)} times; give files of one drive"
        )
    if calib is not None:
        T = body_poses(T, parse_calibration(_plain_file(calib)))
    table = table_of_rows(times, ("stamp_s",), ((line, [text]) for line, text in times.lines()))
    return Trajectory(read_stamps(table), T, TrajectoryFormat.KITTI)


def _plain_file(source: SourceText) -> TextFile:
    return TextFile(source.name, source.text.encode("utf-8"))


def _check_units(trajectory: Trajectory) -> None:
    stamps = trajectory.stamps
    steps_s = np.diff(stamps.stamps_ns) * 1e-9
    if len(steps_s) == 0:
        raise DatasetError(f"{stamps.table.name}: one pose only; a drive needs at least two")
    median_s = float(np.median(steps_s))
    if median_s > SLOWEST_STEP_S:
        raise stamps.table.error(
            1,
            stamps.column,
            f"poses are {median_s:.4g} s apart (median), too far for odometry; are the stamps milli-, micro- or "
            "nanoseconds? Write seconds, or name the columns and call this one stamp_ms, stamp_us or stamp_ns",
        )
    moved_m = _steps_m(trajectory.T_world_body)
    moving = moved_m > 0.0
    speed_mps = float(np.median(moved_m[moving] / steps_s[moving])) if moving.any() else 0.0
    if speed_mps > GREATEST_SPEED_MPS:
        raise stamps.table.error(
            1,
            "x y z",
            f"the body moves at {speed_mps:.4g} m/s (median); positions are metres (are these millimetres?) and stamps "
            "seconds: correct the unit",
        )


def _steps_m(T: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1), dtype=np.float64)
