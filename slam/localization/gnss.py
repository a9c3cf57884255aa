"""Fixes of satellites: where in a georeferenced map the robot may be, and where on earth a map lies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import least_squares

from logs.messages import GeodeticFix, TrajectoryRecord
from slam.common.arrays import FloatArray
from slam.common.georeference import Georeference
from slam.place_recognition.initial_pose import GATE_SIGMAS, InitialPose


class GnssPrior:
    """Where in a map the robot may be by its latest fixes. An outlier among them is one that most others contradict.

    Fixes without covariance are not used: they may be off by any distance.
    """

    def __init__(self, georeference: Georeference) -> None:
        self._georeference = georeference
        self._fixes: list[InitialPose] = []

    def add(self, fix: GeodeticFix, travel_m: float) -> InitialPose | None:
        """Add a fix after ``travel_m`` of the drive; returns the latest that agrees with most others, or None."""
        if fix.covariance is None:
            return None
        position = self._georeference.to_map(geodetic_places([fix]))[0, :2]
        sigma_m = float(np.sqrt(np.linalg.eigvalsh(fix.covariance[:2, :2])[-1]))
        self._fixes = [*self._fixes[-49:], InitialPose(position, sigma_m, at_travel_m=travel_m)]
        for latest in reversed(self._fixes):
            if 2 * sum(_agree(latest, other) for other in self._fixes) > len(self._fixes):
                return latest
        return None


def geodetic_places(fixes: Sequence[GeodeticFix]) -> FloatArray:
    """Latitude, longitude [deg] and altitude [m] (N, 3) of fixes."""
    return np.array([[fix.latitude_deg, fix.longitude_deg, fix.altitude_m] for fix in fixes])


def _agree(a: InitialPose, b: InitialPose) -> bool:
    reach_m = GATE_SIGMAS * float(np.hypot(a.sigma_m, b.sigma_m)) + abs(a.at_travel_m - b.at_travel_m)
    return float(np.linalg.norm(a.position - b.position)) <= reach_m


def find_georeference(trajectory: TrajectoryRecord, fixes: list[GeodeticFix]) -> Georeference | None:
    """Georeference of a trajectory: the heading and position that fit the fixes best.

    Least squares with Cauchy's loss (Holland and Welsch, 1977), the best of several headings to begin with. Fixes weigh
    by their covariances; those without have the median variance of the others.

    Returns:
        The georeference, its origin that of the map; None for fewer than five fixes during the drive, or a path too
        short against their errors to determine the heading.
    """
    first, last = (trajectory.stamps_ns[0], trajectory.stamps_ns[-1]) if len(trajectory.stamps_ns) else (0, -1)
    used = [fix for fix in fixes if first <= fix.stamp_ns <= last]
    if len(used) < 5:
        return None
    seconds = np.array([(fix.stamp_ns - first) * 1e-9 for fix in used])
    known_s = (trajectory.stamps_ns - first) * 1e-9
    path = np.stack([np.interp(seconds, known_s, trajectory.T_map_body[:, axis, 3]) for axis in range(3)], axis=1)
    geodetic = geodetic_places(used)
    start = Georeference(*np.median(geodetic, axis=0).tolist())
    places = start.to_map(geodetic)
    sigmas = _sigmas(used)
    xy, east_north = path[:, :2] @ [1.0, 1.0j], places[:, :2] @ [1.0, 1.0j]
    turn, shift, error_m = _fit(xy, east_north, sigmas)
    if np.std(xy) < 3.0 * error_m:
        return None
    height_m = np.median(places[:, 2] - path[:, 2])
    origin = start.to_geodetic(np.array([[shift.real, shift.imag, height_m]]))[0]
    return replace(Georeference(*origin.tolist()), yaw_rad=float(np.angle(turn)))


def _sigmas(fixes: list[GeodeticFix]) -> FloatArray:
    """Standard deviation (N,) m of a coordinate in the plane."""
    variances = np.array([np.nan if f.covariance is None else 0.5 * np.trace(f.covariance[:2, :2]) for f in fixes])
    usual = np.nanmedian(variances) if np.isfinite(variances).any() else 1.0
    return np.sqrt(np.where(np.isnan(variances), usual, variances))


def _fit(xy: np.ndarray, places: np.ndarray, sigmas: FloatArray) -> tuple[complex, complex, float]:
    """Rotation and translation of points (N,), complex, onto others, and the median residual [m]."""

    def residuals(motion: FloatArray) -> FloatArray:
        yaw_rad, x, y = motion
        off = (np.exp(1j * yaw_rad) * xy + x + 1j * y - places) / sigmas
        return np.concatenate([off.real, off.imag])

    fits = []
    for yaw_rad in np.linspace(-np.pi, np.pi, 12, endpoint=False):
        off = places - np.exp(1j * yaw_rad) * xy
        fits.append(least_squares(residuals, [yaw_rad, np.median(off.real), np.median(off.imag)], loss="cauchy"))
    yaw_rad, x, y = min(fits, key=lambda fit: fit.cost).x
    turn, shift = np.exp(1j * yaw_rad), complex(x, y)
    return turn, shift, np.median(np.abs(places - turn * xy - shift))
