"""Faults of the odometry's poses. Each public function is a fault."""

from typing import Annotated

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from slam.common.arrays import FloatArray
from slam.common.geometry import invert, make_transform, transform_from_xyz_yaw, yaw_rad
from slam.simulation.faults.parameters import Degrees, Duration, Factor, Metres, Number, Part
from slam.simulation.faults.recording import Recording

_Rate = Annotated[float, Field(ge=-1e4, le=1e4, description="deg/s")]
_TranslationNoise = Annotated[float, Field(ge=0.0, le=10.0, description="m / sqrt(m)")]
_YawNoise = Annotated[float, Field(ge=0.0, le=1.0, description="rad / sqrt(m)")]


def heading_jump(log: Recording, angle_deg: Degrees = 30.0, fraction: Part = 0.5) -> None:
    """The heading of the odometry jumps by DEG at once, at a part of the drive."""
    log.redirect(log.row_at(fraction), _turn(np.deg2rad(angle_deg)))


def pitch_jump(log: Recording, angle_deg: Degrees = 20.0) -> None:
    """Its pitch jumps by DEG at half time."""
    R = Rotation.from_euler("y", angle_deg, degrees=True).as_matrix()
    log.redirect(log.row_at(0.5), make_transform(R, np.zeros(3)))


def odometry_jumps(log: Recording, count: Number = 10, distance_m: Metres = 1.5, *, rng: np.random.Generator) -> None:
    """Its position jumps NUMBER times by M, evenly over the drive, in directions drawn at random."""
    rows = np.linspace(0, len(log.odometry), count + 2)[1:-1].astype(np.int64)
    for row, angle_rad in zip(rows.tolist(), rng.uniform(0.0, 2.0 * np.pi, count).tolist(), strict=True):
        log.redirect(row, _shift(distance_m, angle_rad))


def odometry_not_level(log: Recording, roll_deg: Degrees = -90.0, pitch_deg: Degrees = 0.0) -> None:
    """Its frame is turned, as that of a camera whose first pose is the origin: by DEG of roll, then of pitch."""
    R = Rotation.from_euler("xy", (roll_deg, pitch_deg), degrees=True).as_matrix()
    log.poses = make_transform(R, np.zeros(3)) @ log.poses


def odometry_wild(log: Recording, distance_m: Metres = 1000.0, *, rng: np.random.Generator) -> None:
    """One message at half time is M away and turned at random; the next one is right again."""
    direction_rad, turn_rad = rng.uniform(-np.pi, np.pi, 2).tolist()
    poses, row = log.poses, log.row_at(0.5)
    poses[row] = poses[row] @ _shift(distance_m, direction_rad) @ _turn(turn_rad)
    log.poses = poses


def odometry_freezes(log: Recording, seconds: Duration = 10.0) -> None:
    """It stands still for S from half time on; travel of that time is missing afterwards."""
    steps = log.steps
    steps[log.are_after_half(seconds)[:-1]] = np.eye(4)
    log.steps = steps


def odometry_scale(log: Recording, factor: Factor = 1.2) -> None:
    """Its travel is multiplied."""
    poses = log.poses
    poses[:, :3, 3] = poses[0, :3, 3] + factor * (poses[:, :3, 3] - poses[0, :3, 3])
    log.poses = poses


def odometry_turns(log: Recording, factor: Factor = 1.1) -> None:
    """Its turns are multiplied: the track width or the gyroscope is not calibrated; -1: the sign is wrong."""
    steps = log.steps
    steps[:, :3, :3] = _turn((factor - 1.0) * yaw_rad(steps))[:, :3, :3] @ steps[:, :3, :3]
    log.steps = steps


def gyro_bias(log: Recording, rate_deg_s: _Rate = 3.0, seconds: Duration = 10.0) -> None:
    """Its heading turns by DEG/S too much for S from half time on."""
    turned_ns = np.diff(np.clip(log.stamps_ns, *log.from_half(seconds)))
    log.steps = log.steps @ _turn(np.deg2rad(rate_deg_s) * turned_ns * 1e-9)


def wheel_slip(log: Recording, factor: Factor = 1.5, seconds: Duration = 5.0) -> None:
    """Its travel is multiplied for S from half time on."""
    steps = log.steps
    steps[log.are_after_half(seconds)[:-1], :3, 3] *= factor
    log.steps = steps


def odometry_restart(log: Recording) -> None:
    """Its poses restart at the origin at half time, as after a restart of the node."""
    poses, row = log.poses, log.row_at(0.5)
    poses[row:] = invert(poses[row]) @ poses[row:]
    log.poses = poses


def odometry_translation_noise(log: Recording, sigma: _TranslationNoise = 0.05, *, rng: np.random.Generator) -> None:
    """Its translation has noise on each axis, M/SQRT(M) after 1 m of travel, which adds up."""
    steps = log.steps
    steps[:, :3, 3] += sigma * _root_m(steps)[:, None] * rng.standard_normal((len(steps), 3))
    log.steps = steps


def odometry_yaw_noise(log: Recording, sigma: _YawNoise = 0.005, *, rng: np.random.Generator) -> None:
    """Its heading has noise, RAD/SQRT(M) after 1 m of travel, which adds up."""
    steps = log.steps
    log.steps = steps @ _turn(sigma * _root_m(steps) * rng.standard_normal(len(steps)))


def _root_m(steps: FloatArray) -> FloatArray:
    """Square roots (N,) of the lengths of steps (N, 4, 4)."""
    return np.sqrt(np.linalg.norm(steps[:, :3, 3], axis=1))


def _turn(angle_rad: float | FloatArray) -> FloatArray:
    """Rotations about z: (4, 4), or (N, 4, 4) for angles (N,)."""
    return transform_from_xyz_yaw(np.zeros((*np.shape(angle_rad), 3)), angle_rad)


def _shift(distance_m: float, direction_rad: float) -> FloatArray:
    xyz = np.array([distance_m * np.cos(direction_rad), distance_m * np.sin(direction_rad), 0.0])
    return transform_from_xyz_yaw(xyz, 0.0)
