"""Faults of the odometry's poses."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Annotated

import numpy as np
from scipy.spatial.transform import Rotation

from logs.messages import Odometry
from slam.common.arrays import FloatArray
from slam.common.geometry import invert, make_transform, transform_from_xyz_yaw, yaw_rad
from slam.simulation.faults.fault import (
    ODOMETRY,
    TRUTH,
    Degrees,
    Duration,
    Factor,
    Metres,
    Number,
    Part,
    Range,
    fault,
)
from slam.simulation.faults.stream import (
    HALF,
    Entry,
    Stream,
    by_log_time,
    odometry_of,
    poses_at,
    seconds_ns,
    stamp_at,
    true_poses_at,
)

_Rate = Annotated[float, Range("deg/s", min=-1e4, max=1e4)]
_TranslationNoise = Annotated[float, Range("m / sqrt(m)", max=10.0)]
_YawNoise = Annotated[float, Range("rad / sqrt(m)", max=1.0)]


@fault(ODOMETRY, cases=("5", "30", "90", "180"))
def heading_jump(stream: Stream, angle_deg: Degrees = 30.0, fraction: Part = 0.5) -> list[Entry]:
    """The heading of the odometry jumps by DEG at once, at a part of the drive."""
    return _jump(stream, fraction, transform_from_xyz_yaw(np.zeros(3), np.deg2rad(angle_deg)))


@fault(ODOMETRY)
def pitch_jump(stream: Stream, angle_deg: Degrees = 20.0) -> list[Entry]:
    """Its pitch jumps by DEG at half time."""
    R = Rotation.from_euler("y", angle_deg, degrees=True).as_matrix()
    return _jump(stream, HALF, make_transform(R, np.zeros(3)))


@fault(ODOMETRY, cases=("10:1.5", "1:50"))
def odometry_jumps(
    stream: Stream, count: Number = 10.0, distance_m: Metres = 1.5, *, rng: np.random.Generator
) -> list[Entry]:
    """Its position jumps NUMBER times by M, evenly over the drive, in directions drawn at random."""
    _, T_odom_body = odometry_of(stream)
    rows = np.linspace(0, len(T_odom_body), int(count) + 2)[1:-1].astype(np.int64)
    for row, angle_rad in zip(rows, rng.uniform(0.0, 2.0 * np.pi, len(rows)), strict=True):
        T_odom_body = _redirected(T_odom_body, int(row), _planar_shift(distance_m, float(angle_rad)))
    return _with_poses(stream, T_odom_body)


@fault(ODOMETRY)
def odometry_wild(stream: Stream, distance_m: Metres = 1000.0, *, rng: np.random.Generator) -> list[Entry]:
    """One message at half time is M away and turned at random; the next one is right again."""
    stamps_ns, T_odom_body = odometry_of(stream)
    changed = T_odom_body.copy()
    row = min(int(np.searchsorted(stamps_ns, stamp_at(stream, HALF))), len(changed) - 1)
    direction_rad, turn_rad = rng.uniform(-np.pi, np.pi, 2).tolist()
    turn = transform_from_xyz_yaw(np.zeros(3), turn_rad)
    changed[row] = changed[row] @ _planar_shift(distance_m, direction_rad) @ turn
    return _with_poses(stream, changed)


@fault(ODOMETRY)
def odometry_frozen(stream: Stream, fraction: Part = 0.5) -> list[Entry]:
    """One pose is repeated from a part of the drive on."""
    stamps_ns, T_odom_body = odometry_of(stream)
    changed = T_odom_body.copy()
    row = min(int(np.searchsorted(stamps_ns, stamp_at(stream, fraction))), len(changed) - 1)
    changed[row:] = changed[row]
    return _with_poses(stream, changed)


@fault(ODOMETRY)
def odometry_freezes(stream: Stream, seconds: Duration = 10.0) -> list[Entry]:
    """It stands still for S from half time on; travel of that time is missing afterwards."""
    stamps_ns, T_odom_body = odometry_of(stream)
    begin_ns = stamp_at(stream, HALF)
    still = (stamps_ns[1:] > begin_ns) & (stamps_ns[1:] <= begin_ns + seconds_ns(seconds))
    steps = np.where(still[:, None, None], np.eye(4), _steps(T_odom_body))
    return _with_steps(stream, steps)


@fault(ODOMETRY)
def odometry_scale(stream: Stream, factor: Factor = 1.2) -> list[Entry]:
    """Its travel is multiplied."""
    _, T_odom_body = odometry_of(stream)
    changed = T_odom_body.copy()
    changed[:, :3, 3] = changed[0, :3, 3] + factor * (changed[:, :3, 3] - changed[0, :3, 3])
    return _with_poses(stream, changed)


@fault(ODOMETRY)
def odometry_yaw_inverted(stream: Stream) -> list[Entry]:
    """Its heading turns the other way: the sign of the gyroscope is wrong."""
    return _with_turns(stream, -1.0)


@fault(ODOMETRY)
def odometry_turns(stream: Stream, factor: Factor = 1.1) -> list[Entry]:
    """Its turns are multiplied: the track width or the gyroscope is not calibrated."""
    return _with_turns(stream, factor)


@fault(ODOMETRY, cases=("3:10", "30:1"))
def gyro_bias(stream: Stream, rate_deg_s: _Rate = 3.0, seconds: Duration = 10.0) -> list[Entry]:
    """Its heading turns by DEG/S too much for S from half time on."""
    stamps_ns, T_odom_body = odometry_of(stream)
    begin_ns = stamp_at(stream, HALF)
    inside_ns = np.clip(stamps_ns, begin_ns, begin_ns + seconds_ns(seconds))
    turns = np.deg2rad(rate_deg_s) * np.diff(inside_ns) * 1e-9
    steps = _steps(T_odom_body) @ transform_from_xyz_yaw(np.zeros((len(turns), 3)), turns)
    return _with_steps(stream, steps)


@fault(ODOMETRY, cases=("1.5:5", "0.5:5"))
def wheel_slip(stream: Stream, factor: Factor = 1.5, seconds: Duration = 5.0) -> list[Entry]:
    """Its travel is multiplied for S from half time on."""
    stamps_ns, T_odom_body = odometry_of(stream)
    begin_ns = stamp_at(stream, HALF)
    slips = (stamps_ns[:-1] >= begin_ns) & (stamps_ns[:-1] < begin_ns + seconds_ns(seconds))
    steps = _steps(T_odom_body)
    steps[slips, :3, 3] *= factor
    return _with_steps(stream, steps)


@fault(ODOMETRY)
def odometry_restart(stream: Stream) -> list[Entry]:
    """Its poses begin again at the origin at half time, as after a restart of the node."""
    stamps_ns, T_odom_body = odometry_of(stream)
    row = min(int(np.searchsorted(stamps_ns, stamp_at(stream, HALF))), len(T_odom_body) - 1)
    changed = T_odom_body.copy()
    changed[row:] = invert(changed[row]) @ changed[row:]
    return _with_poses(stream, changed)


@fault(ODOMETRY, neutral=0.0)
def odometry_translation_noise(
    stream: Stream, sigma: _TranslationNoise = 0.05, *, rng: np.random.Generator
) -> list[Entry]:
    """Its translation has noise on each axis, M/SQRT(M) after 1 m of travel, which adds up."""
    steps, root_m = _steps_and_roots(stream)
    steps[:, :3, 3] += sigma * root_m[:, None] * rng.standard_normal((len(steps), 3))
    return _with_steps(stream, steps)


@fault(ODOMETRY, neutral=0.0, cases=("0.017",))
def odometry_yaw_noise(stream: Stream, sigma: _YawNoise = 0.005, *, rng: np.random.Generator) -> list[Entry]:
    """Its heading has noise, RAD/SQRT(M) after 1 m of travel, which adds up."""
    steps, root_m = _steps_and_roots(stream)
    errors = sigma * root_m * rng.standard_normal(len(steps))
    steps[:, :3, :3] = steps[:, :3, :3] @ transform_from_xyz_yaw(np.zeros((len(steps), 3)), errors)[:, :3, :3]
    return _with_steps(stream, steps)


@fault(ODOMETRY)
def odometry_z_down(stream: Stream) -> list[Entry]:
    """Odometry and body have y to the right and z down, as in aviation; the detections do not."""
    _, T_odom_body = odometry_of(stream)
    T_flip = np.diag([1.0, -1.0, -1.0, 1.0])
    return _with_poses(stream, T_flip @ T_odom_body @ T_flip)


@fault(ODOMETRY)
def odometry_interleaved(stream: Stream, offset_m: Metres = 1.0) -> list[Entry]:
    """A second odometry is on the same topic, with its origin M aside."""
    stamps_ns, T_odom_body = odometry_of(stream)
    middles_ns = stamps_ns[:-1] + np.diff(stamps_ns) // 2
    messages = [(e, e.content) for e in stream if isinstance(e.content, Odometry)]
    T_second_odom = transform_from_xyz_yaw(np.array([0.0, offset_m, 0.0]), 0.0)
    added = []
    T_second_odom_body = T_second_odom @ poses_at(stamps_ns, T_odom_body, middles_ns)
    for i, ((entry, before), (later, _)) in enumerate(pairwise(messages)):
        if stamps_ns[i] < middles_ns[i] < stamps_ns[i + 1]:
            record = replace(before, stamp_ns=int(middles_ns[i]), T_odom_body=T_second_odom_body[i])
            added.append(entry.having(record, (entry.log_time_ns + later.log_time_ns) // 2))
    return by_log_time([*stream, *added])


@fault(ODOMETRY, reads=TRUTH, cases=("0.3", "3", "10"))
def odometry_noise(stream: Stream, factor: Factor = 3.0) -> list[Entry]:
    """Its errors against the truth are multiplied."""
    stamps_ns, T_odom_body = odometry_of(stream)
    true_steps = _steps(true_poses_at(stream, stamps_ns))
    T_error = invert(true_steps) @ _steps(T_odom_body)
    turns = Rotation.from_matrix(T_error[:, :3, :3]).as_rotvec() * factor
    scaled = make_transform(Rotation.from_rotvec(turns).as_matrix(), factor * T_error[:, :3, 3])
    return _with_steps(stream, true_steps @ scaled)


def _with_turns(stream: Stream, factor: float) -> list[Entry]:
    """The stream with the heading of each step multiplied."""
    steps = _steps(odometry_of(stream)[1])
    more = transform_from_xyz_yaw(np.zeros((len(steps), 3)), (factor - 1.0) * yaw_rad(steps))
    steps[:, :3, :3] = more[:, :3, :3] @ steps[:, :3, :3]
    return _with_steps(stream, steps)


def _steps_and_roots(stream: Stream) -> tuple[FloatArray, FloatArray]:
    """T_previous_next (N - 1, 4, 4), and the square roots (N - 1,) of their lengths in metres."""
    steps = _steps(odometry_of(stream)[1])
    return steps, np.sqrt(np.linalg.norm(steps[:, :3, 3], axis=1))


def _jump(stream: Stream, fraction: float, T_jump: FloatArray) -> list[Entry]:
    stamps_ns, T_odom_body = odometry_of(stream)
    row = int(np.searchsorted(stamps_ns, stamp_at(stream, fraction)))
    return _with_poses(stream, _redirected(T_odom_body, row, T_jump))


def _redirected(T_odom_body: FloatArray, row: int, T_jump: FloatArray) -> FloatArray:
    """The poses (N, 4, 4), those from ``row`` on moved rigidly, by ``T_jump`` in the axes of the body at ``row``."""
    changed = T_odom_body.copy()
    if row < len(changed):
        changed[row:] = changed[row] @ T_jump @ invert(changed[row]) @ changed[row:]
    return changed


def _planar_shift(distance_m: float, direction_rad: float) -> FloatArray:
    xyz = np.array([distance_m * np.cos(direction_rad), distance_m * np.sin(direction_rad), 0.0])
    return transform_from_xyz_yaw(xyz, 0.0)


def _steps(T_odom_body: FloatArray) -> FloatArray:
    """T_previous_next (N - 1, 4, 4) of N poses."""
    return invert(T_odom_body[:-1]) @ T_odom_body[1:]


def _with_steps(stream: Stream, steps: FloatArray) -> list[Entry]:
    """The stream with the odometry from its first pose on by N - 1 steps."""
    poses = [odometry_of(stream)[1][0]]
    for step in steps:
        poses.append(poses[-1] @ step)
    return _with_poses(stream, np.array(poses))


def _with_poses(stream: Stream, T_odom_body: FloatArray) -> list[Entry]:
    """The stream with the poses (N, 4, 4) in its N messages of odometry."""
    rows = iter(T_odom_body)
    return [
        e.having(replace(e.content, T_odom_body=next(rows))) if isinstance(e.content, Odometry) else e for e in stream
    ]
