"""Faults of the odometry's poses."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from logs.messages import Odometry
from slam.common.arrays import FloatArray
from slam.common.geometry import invert, make_transform, transform_from_xyz_yaw, yaw_rad
from slam.simulation.degradation import DegradationConfig
from slam.simulation.degraded_log import OdometryDrift
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

DRIFT_REFERENCE_M = 100.0
_NO_TURN = 0.0


def jump_heading(stream: Stream, rng: np.random.Generator, angle_deg: float, fraction: float) -> list[Entry]:
    """From one message on, the body is said to be turned by an angle in the plane."""
    return _jump(stream, fraction, transform_from_xyz_yaw(np.zeros(3), np.deg2rad(angle_deg)))


def jump_pitch(stream: Stream, rng: np.random.Generator, angle_deg: float) -> list[Entry]:
    """From the half on, the body is said to be pitched by an angle."""
    R = Rotation.from_euler("y", angle_deg, degrees=True).as_matrix()
    return _jump(stream, HALF, make_transform(R, np.zeros(3)))


def jump_position(stream: Stream, rng: np.random.Generator, count: float, distance_m: float) -> list[Entry]:
    """At ``count`` times, evenly over the messages, the pose jumps in the plane in a direction taken at random."""
    _, T_odom_body = odometry_of(stream)
    rows = np.linspace(0, len(T_odom_body), int(count) + 2)[1:-1].astype(np.int64)
    for row, angle_rad in zip(rows, rng.uniform(0.0, 2.0 * np.pi, len(rows)), strict=True):
        T_odom_body = _redirected(T_odom_body, int(row), _planar_shift(distance_m, float(angle_rad)))
    return _with_poses(stream, T_odom_body)


def send_wild(stream: Stream, rng: np.random.Generator, distance_m: float) -> list[Entry]:
    """One message, at the half, is far away and turned at random; the next one is right again."""
    stamps_ns, T_odom_body = odometry_of(stream)
    changed = T_odom_body.copy()
    row = min(int(np.searchsorted(stamps_ns, stamp_at(stream, HALF))), len(changed) - 1)
    direction_rad, turn_rad = rng.uniform(-np.pi, np.pi, 2).tolist()
    turn = transform_from_xyz_yaw(np.zeros(3), turn_rad)
    changed[row] = changed[row] @ _planar_shift(distance_m, direction_rad) @ turn
    return _with_poses(stream, changed)


def freeze_from(stream: Stream, rng: np.random.Generator, fraction: float) -> list[Entry]:
    """From a part of the drive on, all messages repeat one pose."""
    stamps_ns, T_odom_body = odometry_of(stream)
    changed = T_odom_body.copy()
    row = min(int(np.searchsorted(stamps_ns, stamp_at(stream, fraction))), len(changed) - 1)
    changed[row:] = changed[row]
    return _with_poses(stream, changed)


def freeze_for(stream: Stream, rng: np.random.Generator, seconds: float) -> list[Entry]:
    """From the half on, the pose stands still for a while; what was travelled meanwhile is missing afterwards."""
    stamps_ns, T_odom_body = odometry_of(stream)
    begin_ns = stamp_at(stream, HALF)
    still = (stamps_ns[1:] > begin_ns) & (stamps_ns[1:] <= begin_ns + seconds_ns(seconds))
    steps = np.where(still[:, None, None], np.eye(4), _steps(T_odom_body))
    return _with_poses(stream, _chain(T_odom_body[0], steps))


def scale_travel(stream: Stream, rng: np.random.Generator, factor: float) -> list[Entry]:
    """All travel is longer or shorter by a factor."""
    _, T_odom_body = odometry_of(stream)
    changed = T_odom_body.copy()
    changed[:, :3, 3] = changed[0, :3, 3] + factor * (changed[:, :3, 3] - changed[0, :3, 3])
    return _with_poses(stream, changed)


def invert_yaw(stream: Stream, rng: np.random.Generator) -> list[Entry]:
    """The heading turns the other way: the sign of the gyroscope is wrong."""
    return scale_turns(stream, rng, -1.0)


def scale_turns(stream: Stream, rng: np.random.Generator, factor: float) -> list[Entry]:
    """The heading turns more or less by a factor: the track of the wheels, or the gyroscope, is not calibrated."""
    _, T_odom_body = odometry_of(stream)
    steps = _steps(T_odom_body)
    back = transform_from_xyz_yaw(np.zeros((len(steps), 3)), (factor - 1.0) * yaw_rad(steps))
    steps[:, :3, :3] = back[:, :3, :3] @ steps[:, :3, :3]
    return _with_poses(stream, _chain(T_odom_body[0], steps))


def bias_gyroscope(stream: Stream, rng: np.random.Generator, rate_deg_s: float, seconds: float) -> list[Entry]:
    """From the half on, the heading turns by a constant rate too much, for a while."""
    stamps_ns, T_odom_body = odometry_of(stream)
    begin_ns = stamp_at(stream, HALF)
    inside_ns = np.clip(stamps_ns, begin_ns, begin_ns + seconds_ns(seconds))
    turns = np.deg2rad(rate_deg_s) * np.diff(inside_ns) * 1e-9
    steps = _steps(T_odom_body) @ transform_from_xyz_yaw(np.zeros((len(turns), 3)), turns)
    return _with_poses(stream, _chain(T_odom_body[0], steps))


def slip(stream: Stream, rng: np.random.Generator, factor: float, seconds: float) -> list[Entry]:
    """From the half on, wheels slip for a while: the travel of each step is multiplied by a factor."""
    stamps_ns, T_odom_body = odometry_of(stream)
    begin_ns = stamp_at(stream, HALF)
    slips = (stamps_ns[:-1] >= begin_ns) & (stamps_ns[:-1] < begin_ns + seconds_ns(seconds))
    steps = _steps(T_odom_body)
    steps[slips, :3, 3] *= factor
    return _with_poses(stream, _chain(T_odom_body[0], steps))


def start_over(stream: Stream, rng: np.random.Generator) -> list[Entry]:
    """From the half on, poses begin again at the origin, as after a restart of the node."""
    stamps_ns, T_odom_body = odometry_of(stream)
    row = min(int(np.searchsorted(stamps_ns, stamp_at(stream, HALF))), len(T_odom_body) - 1)
    changed = T_odom_body.copy()
    changed[row:] = invert(changed[row]) @ changed[row:]
    return _with_poses(stream, changed)


def drift_heading(stream: Stream, rng: np.random.Generator, sigma_deg: float) -> list[Entry]:
    """The heading walks at random with the path, by ``sigma_deg`` rms after 100 m."""
    sigma = float(np.deg2rad(sigma_deg) / np.sqrt(DRIFT_REFERENCE_M))
    drift = OdometryDrift(DegradationConfig(odometry_yaw_noise=sigma), rng=rng)
    return [e.having(drift.add(e.content)) if isinstance(e.content, Odometry) else e for e in stream]


def point_z_down(stream: Stream, rng: np.random.Generator) -> list[Entry]:
    """Odometry and body are told with y to the right and z down, as in aviation, the detections as before."""
    _, T_odom_body = odometry_of(stream)
    T_flip = np.diag([1.0, -1.0, -1.0, 1.0])
    return _with_poses(stream, T_flip @ T_odom_body @ T_flip)


def interleave(stream: Stream, rng: np.random.Generator, offset_m: float) -> list[Entry]:
    """Between each two messages stands one of a second odometry, whose origin lies to the side of the first."""
    stamps_ns, T_odom_body = odometry_of(stream)
    middles_ns = stamps_ns[:-1] + np.diff(stamps_ns) // 2
    messages = [(e, e.content) for e in stream if isinstance(e.content, Odometry)]
    T_second_odom = transform_from_xyz_yaw(np.array([0.0, offset_m, 0.0]), _NO_TURN)
    added = []
    T_second_odom_body = T_second_odom @ poses_at(stamps_ns, T_odom_body, middles_ns)
    for i, ((entry, before), (later, _)) in enumerate(pairwise(messages)):
        if stamps_ns[i] < middles_ns[i] < stamps_ns[i + 1]:
            record = replace(before, stamp_ns=int(middles_ns[i]), T_odom_body=T_second_odom_body[i])
            added.append(entry.having(record, (entry.log_time_ns + later.log_time_ns) // 2))
    return by_log_time([*stream, *added])


def scale_odometry_noise(stream: Stream, rng: np.random.Generator, factor: float) -> list[Entry]:
    """The error of each step against the truth, its turn and its translation, is multiplied by a factor."""
    stamps_ns, T_odom_body = odometry_of(stream)
    true_steps = _steps(true_poses_at(stream, stamps_ns))
    T_error = invert(true_steps) @ _steps(T_odom_body)
    turns = Rotation.from_matrix(T_error[:, :3, :3]).as_rotvec() * factor
    scaled = make_transform(Rotation.from_rotvec(turns).as_matrix(), factor * T_error[:, :3, 3])
    return _with_poses(stream, _chain(T_odom_body[0], true_steps @ scaled))


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
    return transform_from_xyz_yaw(xyz, _NO_TURN)


def _steps(T_odom_body: FloatArray) -> FloatArray:
    """T_previous_next (N - 1, 4, 4) of N poses."""
    return invert(T_odom_body[:-1]) @ T_odom_body[1:]


def _chain(T_odom_first: FloatArray, steps: FloatArray) -> FloatArray:
    """N poses (N, 4, 4) of the first and N - 1 steps."""
    poses = [T_odom_first]
    for step in steps:
        poses.append(poses[-1] @ step)
    return np.array(poses)


def _with_poses(stream: Stream, T_odom_body: FloatArray) -> list[Entry]:
    """The stream with the poses (N, 4, 4) in its N messages of odometry."""
    rows = iter(T_odom_body)
    return [
        e.having(replace(e.content, T_odom_body=next(rows))) if isinstance(e.content, Odometry) else e for e in stream
    ]
