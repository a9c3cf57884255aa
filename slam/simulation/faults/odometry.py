"""Faults of the odometry's poses."""

from __future__ import annotations

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
    odometry_fault,
)
from slam.simulation.faults.stream import HALF, Entry, Stream, by_log_time, odometry_of, poses_at, true_poses_at
from slam.simulation.faults.track import Track, chain, steps_of

_Rate = Annotated[float, Range("deg/s", min=-1e4, max=1e4)]
_TranslationNoise = Annotated[float, Range("m / sqrt(m)", max=10.0)]
_YawNoise = Annotated[float, Range("rad / sqrt(m)", max=1.0)]


@odometry_fault(cases=("5", "30", "90", "180"))
def heading_jump(track: Track, angle_deg: Degrees = 30.0, fraction: Part = 0.5) -> FloatArray:
    """The heading of the odometry jumps by DEG at once, at a part of the drive."""
    return track.redirected(track.row_at(fraction), _turn(np.deg2rad(angle_deg)))


@odometry_fault()
def pitch_jump(track: Track, angle_deg: Degrees = 20.0) -> FloatArray:
    """Its pitch jumps by DEG at half time."""
    R = Rotation.from_euler("y", angle_deg, degrees=True).as_matrix()
    return track.redirected(track.row_at(HALF), make_transform(R, np.zeros(3)))


@odometry_fault(cases=("10:1.5", "1:50"))
def odometry_jumps(
    track: Track, count: Number = 10.0, distance_m: Metres = 1.5, *, rng: np.random.Generator
) -> FloatArray:
    """Its position jumps NUMBER times by M, evenly over the drive, in directions drawn at random."""
    rows = np.linspace(0, len(track), int(count) + 2)[1:-1].astype(np.int64)
    for row, angle_rad in zip(rows.tolist(), rng.uniform(0.0, 2.0 * np.pi, len(rows)).tolist(), strict=True):
        track = Track(track.stream, track.stamps_ns, track.redirected(row, _shift(distance_m, angle_rad)))
    return track.poses


@odometry_fault()
def odometry_wild(track: Track, distance_m: Metres = 1000.0, *, rng: np.random.Generator) -> FloatArray:
    """One message at half time is M away and turned at random; the next one is right again."""
    direction_rad, turn_rad = rng.uniform(-np.pi, np.pi, 2).tolist()
    changed, row = track.poses.copy(), track.last_row_at(HALF)
    changed[row] = changed[row] @ _shift(distance_m, direction_rad) @ _turn(turn_rad)
    return changed


@odometry_fault()
def odometry_frozen(track: Track, fraction: Part = 0.5) -> FloatArray:
    """One pose is repeated from a part of the drive on."""
    rows = np.minimum(np.arange(len(track)), track.last_row_at(fraction))
    return track.poses[rows]


@odometry_fault()
def odometry_freezes(track: Track, seconds: Duration = 10.0) -> FloatArray:
    """It stands still for S from half time on; travel of that time is missing afterwards."""
    begin_ns, end_ns = track.span_ns(seconds)
    still = (track.stamps_ns[1:] > begin_ns) & (track.stamps_ns[1:] <= end_ns)
    return track.chained(np.where(still[:, None, None], np.eye(4), track.steps))


@odometry_fault()
def odometry_scale(track: Track, factor: Factor = 1.2) -> FloatArray:
    """Its travel is multiplied."""
    changed = track.poses.copy()
    changed[:, :3, 3] = changed[0, :3, 3] + factor * (changed[:, :3, 3] - changed[0, :3, 3])
    return changed


@odometry_fault()
def odometry_yaw_inverted(track: Track) -> FloatArray:
    """Its heading turns the other way: the sign of the gyroscope is wrong."""
    return _with_turns(track, -1.0)


@odometry_fault()
def odometry_turns(track: Track, factor: Factor = 1.1) -> FloatArray:
    """Its turns are multiplied: the track width or the gyroscope is not calibrated."""
    return _with_turns(track, factor)


@odometry_fault(cases=("3:10", "30:1"))
def gyro_bias(track: Track, rate_deg_s: _Rate = 3.0, seconds: Duration = 10.0) -> FloatArray:
    """Its heading turns by DEG/S too much for S from half time on."""
    turned_ns = np.diff(np.clip(track.stamps_ns, *track.span_ns(seconds)))
    return track.chained(track.steps @ _turn(np.deg2rad(rate_deg_s) * turned_ns * 1e-9))


@odometry_fault(cases=("1.5:5", "0.5:5"))
def wheel_slip(track: Track, factor: Factor = 1.5, seconds: Duration = 5.0) -> FloatArray:
    """Its travel is multiplied for S from half time on."""
    begin_ns, end_ns = track.span_ns(seconds)
    steps = track.steps
    steps[(track.stamps_ns[:-1] >= begin_ns) & (track.stamps_ns[:-1] < end_ns), :3, 3] *= factor
    return track.chained(steps)


@odometry_fault()
def odometry_restart(track: Track) -> FloatArray:
    """Its poses restart at the origin at half time, as after a restart of the node."""
    changed, row = track.poses.copy(), track.last_row_at(HALF)
    changed[row:] = invert(changed[row]) @ changed[row:]
    return changed


@odometry_fault(neutral=0.0)
def odometry_translation_noise(
    track: Track, sigma: _TranslationNoise = 0.05, *, rng: np.random.Generator
) -> FloatArray:
    """Its translation has noise on each axis, M/SQRT(M) after 1 m of travel, which adds up."""
    steps = track.steps
    steps[:, :3, 3] += sigma * _root_m(steps)[:, None] * rng.standard_normal((len(steps), 3))
    return track.chained(steps)


@odometry_fault(neutral=0.0, cases=("0.017",))
def odometry_yaw_noise(track: Track, sigma: _YawNoise = 0.005, *, rng: np.random.Generator) -> FloatArray:
    """Its heading has noise, RAD/SQRT(M) after 1 m of travel, which adds up."""
    steps = track.steps
    errors = sigma * _root_m(steps) * rng.standard_normal(len(steps))
    steps[:, :3, :3] = steps[:, :3, :3] @ _turn(errors)[:, :3, :3]
    return track.chained(steps)


@odometry_fault()
def odometry_z_down(track: Track) -> FloatArray:
    """Odometry and body have y to the right and z down, as in aviation; the detections do not."""
    T_flip = np.diag([1.0, -1.0, -1.0, 1.0])
    return T_flip @ track.poses @ T_flip


@odometry_fault(reads=TRUTH, cases=("0.3", "3", "10"))
def odometry_noise(track: Track, factor: Factor = 3.0) -> FloatArray:
    """Its errors against the truth are multiplied."""
    true_steps = steps_of(true_poses_at(track.stream, track.stamps_ns))
    T_error = invert(true_steps) @ track.steps
    turns = Rotation.from_matrix(T_error[:, :3, :3]).as_rotvec() * factor
    scaled = make_transform(Rotation.from_rotvec(turns).as_matrix(), factor * T_error[:, :3, 3])
    return chain(track.poses[0], true_steps @ scaled)


@fault(ODOMETRY)
def odometry_interleaved(stream: Stream, offset_m: Metres = 1.0) -> list[Entry]:
    """A second odometry is on the same topic, with its origin M aside."""
    stamps_ns, T_odom_body = odometry_of(stream)
    middles_ns = stamps_ns[:-1] + np.diff(stamps_ns) // 2
    messages = [e for e in stream if isinstance(e.content, Odometry)]
    T_second_odom = transform_from_xyz_yaw(np.array([0.0, offset_m, 0.0]), 0.0)
    between = T_second_odom @ poses_at(stamps_ns, T_odom_body, middles_ns)
    added = [
        entry.with_fields((entry.log_time_ns + later.log_time_ns) // 2, stamp_ns=int(middle_ns), T_odom_body=T)
        for (entry, later), middle_ns, T in zip(pairwise(messages), middles_ns, between, strict=True)
        if entry.stamp_ns < middle_ns < later.stamp_ns
    ]
    return by_log_time([*stream, *added])


def _with_turns(track: Track, factor: float) -> FloatArray:
    """The poses with the heading of each step multiplied."""
    steps = track.steps
    steps[:, :3, :3] = _turn((factor - 1.0) * yaw_rad(steps))[:, :3, :3] @ steps[:, :3, :3]
    return track.chained(steps)


def _root_m(steps: FloatArray) -> FloatArray:
    """Square roots (N,) of the lengths of steps (N, 4, 4)."""
    return np.asarray(np.sqrt(np.linalg.norm(steps[:, :3, 3], axis=1)))


def _turn(angle_rad: float | FloatArray) -> FloatArray:
    """Rotations about z: (4, 4), or (N, 4, 4) for angles (N,)."""
    return transform_from_xyz_yaw(np.zeros((*np.shape(angle_rad), 3)), angle_rad)


def _shift(distance_m: float, direction_rad: float) -> FloatArray:
    xyz = np.array([distance_m * np.cos(direction_rad), distance_m * np.sin(direction_rad), 0.0])
    return transform_from_xyz_yaw(xyz, 0.0)
