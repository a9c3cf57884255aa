"""Faults of the odometry's poses."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from slam.common.arrays import FloatArray
from slam.common.geometry import invert, make_transform, transform_from_xyz_yaw, yaw_rad
from slam.simulation.faults.fault import Degrees, Duration, Factor, Metres, Number, Part, fault
from slam.simulation.faults.recording import Message, Recording, by_log_time, steps_of

_Rate = Annotated[float, Field(ge=-1e4, le=1e4, description="deg/s")]
_TranslationNoise = Annotated[float, Field(ge=0.0, le=10.0, description="m / sqrt(m)")]
_YawNoise = Annotated[float, Field(ge=0.0, le=1.0, description="rad / sqrt(m)")]


@fault("5", "30", "90", "180")
def heading_jump(log: Recording, angle_deg: Degrees = 30.0, fraction: Part = 0.5) -> Recording:
    """The heading of the odometry jumps by DEG at a part of the drive."""
    return log.redirected(log.row_at(fraction), _turn(np.deg2rad(angle_deg)))


@fault()
def pitch_jump(log: Recording, angle_deg: Degrees = 20.0) -> Recording:
    """Its pitch jumps by DEG in the middle of the drive."""
    R = Rotation.from_euler("y", angle_deg, degrees=True).as_matrix()
    return log.redirected(log.row_at(0.5), make_transform(R, np.zeros(3)))


@fault("10:1.5", "1:50")
def odometry_jumps(
    log: Recording, count: Number = 10, distance_m: Metres = 1.5, *, rng: np.random.Generator
) -> Recording:
    """Its position jumps NUMBER times by M, evenly over the drive, in directions drawn at random."""
    rows = np.linspace(0, len(log.odometry), count + 2)[1:-1].astype(np.int64)
    for row, angle_rad in zip(rows.tolist(), rng.uniform(0.0, 2.0 * np.pi, count).tolist(), strict=True):
        log = log.redirected(row, _shift(distance_m, angle_rad))
    return log


@fault()
def odometry_wild(log: Recording, distance_m: Metres = 1000.0, *, rng: np.random.Generator) -> Recording:
    """One message in the middle of the drive is M away and turned at random; the next one is right again."""
    direction_rad, turn_rad = rng.uniform(-np.pi, np.pi, 2).tolist()
    poses, row = log.poses, _last_row_at(log, 0.5)
    poses[row] = poses[row] @ _shift(distance_m, direction_rad) @ _turn(turn_rad)
    return log.with_poses(poses)


@fault()
def odometry_frozen(log: Recording, fraction: Part = 0.5) -> Recording:
    """One pose is repeated from a part of the drive on."""
    return log.with_poses(log.poses[np.minimum(np.arange(len(log.odometry)), _last_row_at(log, fraction))])


@fault()
def odometry_freezes(log: Recording, seconds: Duration = 10.0) -> Recording:
    """It stands still for S from the middle of the drive on; travel of that time is missing afterwards."""
    begin_ns, end_ns = log.from_half(seconds)
    still = (log.stamps_ns[1:] > begin_ns) & (log.stamps_ns[1:] <= end_ns)
    return log.with_steps(np.where(still[:, None, None], np.eye(4), log.steps))


@fault()
def odometry_scale(log: Recording, factor: Factor = 1.2) -> Recording:
    """Its travel is multiplied."""
    poses = log.poses
    poses[:, :3, 3] = poses[0, :3, 3] + factor * (poses[:, :3, 3] - poses[0, :3, 3])
    return log.with_poses(poses)


@fault()
def odometry_yaw_inverted(log: Recording) -> Recording:
    """Its heading turns the other way: the sign of the gyroscope is wrong."""
    return _with_turns(log, -1.0)


@fault()
def odometry_turns(log: Recording, factor: Factor = 1.1) -> Recording:
    """Its turns are multiplied: the track width or the gyroscope is not calibrated."""
    return _with_turns(log, factor)


@fault("3:10", "30:1")
def gyro_bias(log: Recording, rate_deg_s: _Rate = 3.0, seconds: Duration = 10.0) -> Recording:
    """Its heading turns by DEG/S too much for S from the middle of the drive on."""
    turned_ns = np.diff(np.clip(log.stamps_ns, *log.from_half(seconds)))
    return log.with_steps(log.steps @ _turn(np.deg2rad(rate_deg_s) * turned_ns * 1e-9))


@fault("1.5:5", "0.5:5")
def wheel_slip(log: Recording, factor: Factor = 1.5, seconds: Duration = 5.0) -> Recording:
    """Its travel is multiplied for S from the middle of the drive on."""
    begin_ns, end_ns = log.from_half(seconds)
    steps = log.steps
    steps[(log.stamps_ns[:-1] >= begin_ns) & (log.stamps_ns[:-1] < end_ns), :3, 3] *= factor
    return log.with_steps(steps)


@fault()
def odometry_restart(log: Recording) -> Recording:
    """Its poses restart at the origin in the middle of the drive, as after a restart of the node."""
    poses, row = log.poses, _last_row_at(log, 0.5)
    poses[row:] = invert(poses[row]) @ poses[row:]
    return log.with_poses(poses)


@fault()
def odometry_translation_noise(
    log: Recording, sigma: _TranslationNoise = 0.05, *, rng: np.random.Generator
) -> Recording:
    """Its translation has noise on each axis, M/SQRT(M) after 1 m of travel, which adds up."""
    steps = log.steps
    steps[:, :3, 3] += sigma * _root_m(steps)[:, None] * rng.standard_normal((len(steps), 3))
    return log.with_steps(steps)


@fault("0.017")
def odometry_yaw_noise(log: Recording, sigma: _YawNoise = 0.005, *, rng: np.random.Generator) -> Recording:
    """Its heading has noise, RAD/SQRT(M) after 1 m of travel, which adds up."""
    steps = log.steps
    errors = sigma * _root_m(steps) * rng.standard_normal(len(steps))
    steps[:, :3, :3] = steps[:, :3, :3] @ _turn(errors)[:, :3, :3]
    return log.with_steps(steps)


@fault()
def odometry_z_down(log: Recording) -> Recording:
    """Odometry and body have y to the right and z down, as in aviation; the detections do not."""
    T_flip = np.diag([1.0, -1.0, -1.0, 1.0])
    return log.with_poses(T_flip @ log.poses @ T_flip)


@fault("0.3", "3", "10")
def odometry_noise(log: Recording, factor: Factor = 3.0) -> Recording:
    """Its errors against the truth are multiplied."""
    true_steps = steps_of(log.true_poses_at(log.stamps_ns))
    T_error = invert(true_steps) @ log.steps
    turns = Rotation.from_matrix(T_error[:, :3, :3]).as_rotvec() * factor
    scaled = make_transform(Rotation.from_rotvec(turns).as_matrix(), factor * T_error[:, :3, 3])
    return log.with_steps(true_steps @ scaled)


@fault()
def odometry_interleaved(log: Recording, offset_m: Metres = 1.0) -> Recording:
    """A second odometry is on the same topic, with its origin M aside."""
    stamps_ns = log.stamps_ns
    middles_ns = stamps_ns[:-1] + np.diff(stamps_ns) // 2
    between = transform_from_xyz_yaw(np.array([0.0, offset_m, 0.0]), 0.0) @ log.poses_at(middles_ns)
    added = []
    for row in np.flatnonzero(np.diff(stamps_ns) > 1).tolist():
        message, later = log.odometry[row : row + 2]
        record = replace(message.record, stamp_ns=int(middles_ns[row]), T_odom_body=between[row])
        log_time_ns = (message.log_time_ns + later.log_time_ns) // 2
        added.append(Message(message.topic, log_time_ns, record, message.number))
    return replace(log, odometry=by_log_time((*log.odometry, *added)))


def _last_row_at(log: Recording, fraction: float) -> int:
    """The first pose after a part of the time of the drive, the last one where there is none."""
    return min(log.row_at(fraction), len(log.odometry) - 1)


def _with_turns(log: Recording, factor: float) -> Recording:
    """The poses with the heading of each step multiplied."""
    steps = log.steps
    steps[:, :3, :3] = _turn((factor - 1.0) * yaw_rad(steps))[:, :3, :3] @ steps[:, :3, :3]
    return log.with_steps(steps)


def _root_m(steps: FloatArray) -> FloatArray:
    """Square roots (N,) of the lengths of steps (N, 4, 4)."""
    return np.asarray(np.sqrt(np.linalg.norm(steps[:, :3, 3], axis=1)))


def _turn(angle_rad: float | FloatArray) -> FloatArray:
    """Rotations about z: (4, 4), or (N, 4, 4) for angles (N,)."""
    return transform_from_xyz_yaw(np.zeros((*np.shape(angle_rad), 3)), angle_rad)


def _shift(distance_m: float, direction_rad: float) -> FloatArray:
    xyz = np.array([distance_m * np.cos(direction_rad), distance_m * np.sin(direction_rad), 0.0])
    return transform_from_xyz_yaw(xyz, 0.0)
