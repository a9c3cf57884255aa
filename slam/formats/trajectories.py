"""Trajectories in the text formats of other programs: TUM, KITTI, and a table of places on earth."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from logs.storage.placement import write_text
from slam.common.arrays import FloatArray, IntArray
from slam.common.georeference import Georeference


def write_tum(path: str | Path, stamps_ns: IntArray, T_map_body: FloatArray) -> None:
    """Write ``stamp x y z qx qy qz qw`` a line: seconds with all nine digits of the nanoseconds, metres, body in map.

    Numbers other than the stamp are the shortest decimals that read back to the same float64.

    Raises:
        UnwritableLogError: the file cannot be written.
    """
    rows, stamps = position_and_quaternion(T_map_body), map(_seconds, stamps_ns.tolist())
    write_lines(path, (f"{stamp} {format_numbers(row)}" for stamp, row in zip(stamps, rows, strict=True)))


def write_geodetic(path: Path, stamps_ns: IntArray, T_map_body: FloatArray, georeference: Georeference) -> None:
    """Write a row a pose: time [s], latitude, longitude [deg] and altitude [m] on WGS 84.

    Raises:
        UnwritableLogError: the file cannot be written.
    """
    places = georeference.to_geodetic(T_map_body[:, :3, 3]).tolist()
    rows = [
        f"{_seconds(stamp_ns)},{latitude:.9f},{longitude:.9f},{altitude_m:.3f}"
        for stamp_ns, (latitude, longitude, altitude_m) in zip(stamps_ns.tolist(), places, strict=True)
    ]
    write_lines(path, ["stamp_s,latitude_deg,longitude_deg,altitude_m", *rows])


def write_kitti(path: str | Path, T_map_body: FloatArray) -> None:
    """Write the upper 3x4 part of each ``T_map_body``, row by row, a pose a line.

    The poses are those of the **body** (x forward, y left, z up) in the map, one for each odometry message; KITTI's own
    files hold the left camera's (x right, y down, z forward). Errors over stretches of path compare either way,
    provided that both files hold the same frame. The format has no stamps.

    Raises:
        UnwritableLogError: the file cannot be written.
    """
    write_lines(path, (format_numbers(T[:3].ravel()) for T in T_map_body))


def write_lines(path: str | Path, lines: Iterable[str]) -> None:
    """Write a text file of these lines.

    Raises:
        UnwritableLogError: the file cannot be written.
    """
    write_text(path, "".join(f"{line}\n" for line in lines))


def _seconds(stamp_ns: int) -> str:
    return f"{stamp_ns // 10**9}.{stamp_ns % 10**9:09d}"


def format_numbers(values: FloatArray) -> str:
    """Values (N,) with blanks between, the shortest decimals that read back to the same float64."""
    return " ".join(map(repr, values.tolist()))


def position_and_quaternion(poses: FloatArray) -> FloatArray:
    """(N, 7) x y z and quaternion x y z w of poses (N, 4, 4)."""
    return np.hstack([poses[:, :3, 3], Rotation.from_matrix(poses[:, :3, :3]).as_quat()])
