"""Fixes of satellites: where in a georeferenced map the robot may be, where on earth a map lies, edges of the graph.

The antenna is anywhere in the body: where it is follows from the fixes.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import least_squares
from scipy.special import chdtri

from logs.messages import GeodeticFix, TrajectoryRecord
from logs.records import frozen
from slam.backend.factor_graph import FactorGraph
from slam.backend.factors import EARTH, Edge, EdgeKind
from slam.common.arrays import FloatArray, IntArray
from slam.common.errors import GeometryError
from slam.common.geometry import interpolate, invert, transform_from_xyz_yaw, yaw_rad
from slam.common.georeference import Georeference
from slam.frontend.data_association import DECIDED
from slam.odometry.keyframe import Keyframe
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


def find_georeference(trajectory: TrajectoryRecord, fixes: Sequence[GeodeticFix]) -> Georeference | None:
    """Georeference of a trajectory: the heading and position that fit the fixes best; its origin is that of the map.

    None for fewer than five fixes during the drive, or a path too short against their errors to determine the heading.
    """
    laid = _lay(trajectory, fixes)
    return None if laid is None else laid.georeference


def tie_to_fixes(
    graph: FactorGraph,
    keyframes: Sequence[Keyframe],
    trajectory: Callable[[], TrajectoryRecord],
    fixes: Sequence[GeodeticFix],
) -> int:
    """Optimise the graph with an edge for each fix; returns how many fixes are used.

    Fixes are laid on the trajectory, which tells the place of the antenna and their errors, and move it, in turns.
    Their covariances only tell their relative weights. How large their errors are shows in what is left, and so does
    whether they are alike over time: if they are a first-order autoregression with the correlation rho between
    successive fixes, n of them are worth n (1 - rho) / (1 + rho) independent ones. In the first turn a drift of the map
    counts as an error of the fixes, so that they have less weight than they are worth.

    Args:
        graph: with the keyframes of the drive.
        keyframes: (K,) those.
        trajectory: of the drive, by the graph as it is now.
        fixes: of satellites.
    """
    graph.assume_gaussian_odometry()
    variance, used = np.inf, 0
    stamps_ns = np.array([keyframe.odometry.stamp_ns for keyframe in keyframes])
    while (laid := _lay(trajectory(), fixes)) is not None:
        before, variance = variance, laid.variance()
        rows = np.searchsorted(stamps_ns, laid.stamps_ns, side="right") - 1
        ids = [keyframes[row].id for row in rows.tolist()]
        T_map_body = graph.poses(ids)
        T_map_body[:, :2, 3] += laid.residuals_m
        T_earth_body = invert(laid.T_map_earth) @ T_map_body
        variances = np.maximum(variance * laid.sigmas_m**2, graph.prior_sigma_m**2)
        covariances = _covariances(T_earth_body[:, :3, :3], variances)
        edges = [
            Edge(EARTH, keyframe, T, covariance, EdgeKind.GNSS)
            for keyframe, T, covariance in zip(ids, T_earth_body, covariances, strict=True)
            if keyframe != graph.keyframes[0]  # in logs, edges of fixes lead from there
        ]
        graph.replace_fixes(laid.T_map_earth, edges)
        graph.optimize(roughly=True)
        used = len(edges)
        if variance > 0.9 * before:  # it falls no more
            break
    return used


def _covariances(R: FloatArray, variances: FloatArray) -> FloatArray:
    """Covariances (N, 6, 6) of poses with orientations (N, 3, 3) of which the position in the plane is known, with
    variances (N,) m^2.
    """
    covariances = np.zeros((len(R), 6, 6))
    covariances[:, :3, :3] = np.pi**2 * np.eye(3)  # a fix tells no orientation
    upright = np.diag([1.0, 1.0, 1e4])  # nor a height
    covariances[:, 3:, 3:] = variances[:, None, None] * (np.swapaxes(R, 1, 2) @ upright @ R)
    return covariances


@frozen
class LaidFixes:
    """Fixes laid on a trajectory: their ``stamps_ns`` (N,), their claimed ``sigmas_m`` (N,), and ``residuals_m`` (N, 2)
    by which they put the body elsewhere in the map. ``T_map_earth`` (4, 4): where east, north and up are in the map.
    """

    georeference: Georeference
    T_map_earth: FloatArray
    stamps_ns: IntArray
    sigmas_m: FloatArray
    residuals_m: FloatArray

    def variance(self) -> float:
        """Factor on the variances of the fixes by their residuals, and by how much these are alike over time."""
        whitened = self.residuals_m / self.sigmas_m[:, None]
        squares = np.einsum("ni,ni->n", whitened, whitened)
        scale = float(np.median(squares)) / (2.0 * np.log(2.0))  # the median of chi-squared with two degrees of freedom
        whitened = whitened / np.sqrt(scale + squares + 1e-300)[:, None]  # bounded, against outliers
        correlation = (whitened[1:] * whitened[:-1]).sum() / max((whitened**2).sum(), 1e-300)
        correlation = np.clip(correlation, 0.0, 1.0 - 1.0 / len(squares))
        return float(scale * (1.0 + correlation) / (1.0 - correlation))


def _lay(trajectory: TrajectoryRecord, fixes: Sequence[GeodeticFix]) -> LaidFixes | None:
    """Fixes on a trajectory, by least squares with Cauchy's loss (Holland and Welsch, 1977), from the likeliest
    of several headings; None where there are too few, or where the path is too short against their errors. The
    antenna is at the origin of the body unless that is unlikely.

    Fixes weigh by their covariances; those without have the median variance of the others.
    """
    first, last = (trajectory.stamps_ns[0], trajectory.stamps_ns[-1]) if len(trajectory.stamps_ns) else (0, -1)
    used = [fix for fix in fixes if first <= fix.stamp_ns <= last]
    if len(used) < 5:
        return None
    stamps_ns = np.array([fix.stamp_ns for fix in used], dtype=np.int64)
    T_map_body = interpolate(trajectory.stamps_ns, trajectory.T_map_body, stamps_ns)
    geodetic, sigmas_m = geodetic_places(used), _sigmas(used)
    try:
        start = Georeference(*np.median(geodetic, axis=0).tolist())
    except GeometryError:  # at a pole
        return None
    places = start.to_map(geodetic)
    xy, east_north = (points[:, :2] @ [1.0, 1.0j] for points in (T_map_body[:, :3, 3], places))
    headings = np.exp(1j * yaw_rad(T_map_body))
    for arms in (headings, np.zeros_like(headings)):
        motion, information = _fit(xy, arms, east_north, sigmas_m)
        turn, shift, arm = np.exp(1j * motion[0]), complex(*motion[1:3]), complex(*motion[3:])
        left = (east_north - shift) / turn - arms * arm - xy
        height_m = np.median(places[:, 2] - T_map_body[:, 2, 3])
        origin = start.to_geodetic(np.array([[shift.real, shift.imag, height_m]]))[0]
        georeference = replace(Georeference(*origin.tolist()), yaw_rad=float(np.angle(turn)))
        T_earth_map = transform_from_xyz_yaw(np.array([shift.real, shift.imag, 0.0]), georeference.yaw_rad)
        laid = LaidFixes(
            georeference, invert(T_earth_map), stamps_ns, sigmas_m, np.column_stack([left.real, left.imag])
        )
        if motion[3:] @ information @ motion[3:] > laid.variance() * chdtri(2, 1.0 - DECIDED):
            break
    return laid if np.std(xy) >= 3.0 * np.median(np.abs(left)) else None


def _sigmas(fixes: Sequence[GeodeticFix]) -> FloatArray:
    """Standard deviation (N,) m of a coordinate in the plane."""
    variances = np.array([np.nan if f.covariance is None else 0.5 * np.trace(f.covariance[:2, :2]) for f in fixes])
    is_known = variances > 0.0
    usual = np.median(variances[is_known]) if is_known.any() else 1.0
    return np.sqrt(np.where(is_known, variances, usual))


def _fit(xy: np.ndarray, arms: np.ndarray, places: np.ndarray, sigmas_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The motion (5,) of points (N,), complex, onto others: a rotation [rad], a translation [m], and where the antenna
    is in the body, ahead and left [m], along ``arms`` (N,) of length 1; and the information (2, 2) of that place.
    """

    def residuals(motion: FloatArray) -> FloatArray:
        yaw, x, y, ahead, left = motion
        off = (np.exp(1j * yaw) * (xy + arms * (ahead + 1j * left)) + x + 1j * y - places) / sigmas_m
        # The origin of the body, where nothing tells.
        return np.concatenate([off.real, off.imag, 1e-3 * motion[3:] / sigmas_m.min()])

    def guess(yaw: float) -> FloatArray:
        off = places - np.exp(1j * yaw) * xy
        return np.array([yaw, np.median(off.real), np.median(off.imag), 0.0, 0.0])

    guesses = map(guess, np.linspace(-np.pi, np.pi, 72, endpoint=False))
    start = min(guesses, key=lambda motion: np.log1p(residuals(motion) ** 2).sum())
    # What the fixes claim tells their relative weights only.
    best = least_squares(residuals, start, loss="cauchy", f_scale=max(float(np.median(np.abs(residuals(start)))), 1e-9))
    others, own = np.split(np.asarray(best.jac), [3], axis=1)
    own = own - others @ np.linalg.lstsq(others, own, rcond=None)[0]
    return best.x, own.T @ own
