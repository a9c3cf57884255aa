"""The tour as it is driven: corners rounded, bends taken slowly, poses at a steady rate."""

import numpy as np
from scipy.ndimage import gaussian_filter1d

from logs.records import frozen
from slam.common.arrays import FloatArray, IntArray
from slam.common.errors import SimulationError
from slam.common.geometry import step_lengths, transform_from_xyz_yaw, travelled_m
from slam.simulation.config import DriveConfig

START_NS = 1_700_000_000_000_000_000
"""Stamp of the first scan; a constant, so that nothing depends on when the simulation ran."""


@frozen
class Drive:
    """True poses at a steady rate: stamps_ns (K,), ``T_world_body`` (K, 4, 4), z = 0."""

    stamps_ns: IntArray
    T_world_body: FloatArray


@frozen
class DrivePlan:
    """The rounded tour in fine steps: tour_m (S,) along the given one, xy (S, 2) m, yaw_rad (S,) unwrapped, time_s."""

    tour_m: FloatArray
    xy: FloatArray
    yaw_rad: FloatArray
    time_s: FloatArray
    period_ns: int

    @property
    def length_m(self) -> float:
        """Length of the given tour, metres."""
        return self.tour_m[-1]

    def sample(self, from_m: float, to_m: float, *, start_ns: int = START_NS) -> Drive:
        """Poses from ``from_m`` to at most ``to_m`` metres along the tour, the first one at ``start_ns``.

        Raises:
            SimulationError: the piece lies outside the tour or has no length.
        """
        if not 0.0 <= from_m < to_m <= self.length_m:
            raise SimulationError(
                f"no drive from {from_m:g} m to {to_m:g} m: the tour reaches from 0 to {self.length_m:.1f} m"
            )
        from_s, to_s = np.interp([from_m, to_m], self.tour_m, self.time_s)
        # A hair is added so that rounding does not lose the last pose.
        count = int((to_s - from_s) * 1e9 / self.period_ns + 1e-6) + 1
        offset_ns = np.arange(count, dtype=np.int64) * self.period_ns
        at_s = from_s + offset_ns * 1e-9
        xyz = np.column_stack([*(np.interp(at_s, self.time_s, axis) for axis in self.xy.T), np.zeros(count)])
        T_world_body = transform_from_xyz_yaw(xyz, np.interp(at_s, self.time_s, self.yaw_rad))
        return Drive(start_ns + offset_ns, T_world_body)


def plan_drive(tour: FloatArray, config: DriveConfig) -> DrivePlan:
    """Round and time the poly-line ``tour`` (M, 2), metres, world frame.

    The tour is resampled and smoothed along its length by a Gaussian of ``corner_smoothing_m``, which cuts a
    right-angled corner by 0.56 of that. The heading is the tangent. Speed is the least of the cruising speed and what
    the limits on yaw rate and lateral acceleration allow, with braking before bends and speeding up after them. Where
    the tour turns back on itself, the body turns on the spot at the greatest yaw rate.

    Raises:
        SimulationError: the rounded tour has no length.
    """
    corner_m = travelled_m(tour)
    count = max(2, int(np.ceil(corner_m[-1] / 0.25)) + 1)  # samples of a tour 0.25 m apart
    tour_m = np.linspace(0.0, corner_m[-1], count)
    xy = np.column_stack([np.interp(tour_m, corner_m, axis) for axis in tour.T])
    xy = _smooth(xy, config.corner_smoothing_m / (tour_m[1] - tour_m[0]))
    # A tour that doubles back meets itself; samples that fall together have no direction.
    apart = np.concatenate([[True], step_lengths(xy) > 1e-9])
    tour_m, xy = tour_m[apart], xy[apart]
    if len(xy) < 2:
        raise SimulationError("the rounded tour has no length; make it longer or corner_smoothing_m smaller")
    along, ds_m = np.diff(xy, axis=0), step_lengths(xy)  # (S - 1, 2), (S - 1,)
    segment_yaw = np.unwrap(np.arctan2(along[:, 1], along[:, 0]))
    yaw = np.concatenate([segment_yaw[:1], 0.5 * (segment_yaw[1:] + segment_yaw[:-1]), segment_yaw[-1:]])
    turn_rad = np.abs(np.diff(yaw))
    speed = _speeds(ds_m, turn_rad, config)
    dt_s = np.maximum(2.0 * ds_m / (speed[1:] + speed[:-1]), turn_rad / config.max_yaw_rate_radps)
    time_s = np.concatenate([[0.0], np.cumsum(dt_s)])
    return DrivePlan(tour_m, xy, yaw, time_s, round(1e9 / config.rate_hz))


def _smooth(xy: FloatArray, sigma_samples: float) -> FloatArray:
    if sigma_samples == 0.0:
        return xy
    # Point reflection about both ends keeps them, and the directions there, where they are.
    pad = min(len(xy) - 1, int(np.ceil(4.0 * sigma_samples)))
    padded = np.pad(xy, ((pad, pad), (0, 0)), mode="reflect", reflect_type="odd")
    return gaussian_filter1d(padded, sigma_samples, axis=0, mode="nearest")[pad : pad + len(xy)]


def _speeds(ds_m: FloatArray, turn_rad: FloatArray, config: DriveConfig) -> FloatArray:
    with np.errstate(divide="ignore"):
        radius_m = ds_m / turn_rad  # (S - 1,), infinite on the straight
    limit = np.minimum(
        config.max_yaw_rate_radps * radius_m, np.sqrt(config.max_lateral_acceleration_mps2 * radius_m)
    ).clip(1e-3, config.speed_mps)
    speed = np.minimum(np.append(limit, limit[-1]), np.insert(limit, 0, limit[0]))  # (S,)
    # v^2 = v0^2 + 2 a s, backwards for braking and forwards for speeding up.
    gain = 2.0 * config.max_acceleration_mps2 * ds_m
    for i in reversed(range(len(ds_m))):
        speed[i] = min(speed[i], np.sqrt(speed[i + 1] ** 2 + gain[i]))
    for i in range(len(ds_m)):
        speed[i + 1] = min(speed[i + 1], np.sqrt(speed[i] ** 2 + gain[i]))
    return speed
