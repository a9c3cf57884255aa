"""The noise of odometry and detections, from how far tracked objects seem to move: variance components by moments.

An object that stands still seems to move by d between two scans, in the odometry frame. Part of d is common to all
objects of the two scans, the error of the odometry between them: a shift and, at the offset x of an object, a turn by
J x. The rest is the detector's. With radial and tangential parts d_r, d_t of d at range r, travel L, turn A, time T and
change of the viewing direction B between the two scans,

    E[d_r^2] = 2 v_r + u_r (r1^2 + r2^2) + w B + common_t
    E[d_t^2] = 2 v_t + u_t (r1^2 + r2^2) + w B + common_t + common_y r^2
    E[d_k . d_l] = 2 common_t + common_y (x_k . x_l)                      for two objects k, l of the same two scans
    E[(J x_k . d_k) (J x_l . d_l)] = common_t (x_k . x_l) + common_y r_k^2 r_l^2
    common_t = 2 j_t + a_t L + b_t T,   common_y = 2 j_y + a_y L + c_y A + b_y T

which is linear in the twelve variances. Means over scan pairs with lags of 1, 2, 4, ... scans give the equations, which
non-negative least squares solves (least-squares variance component estimation: Teunissen and Amiri-Simkooei, J. Geodesy
2008; here with the means' own sampling errors as weights). Displacements are clipped at eight times their median, so
that slips, wrong matches and moving objects count little, and what they have beyond the common motion of their scans
at three (:mod:`slam.self_calibration.displacement_outliers`). Uncertainty is found by leaving out a block of time at a
time (the jackknife), and is not less than what the misfit of the equations leaves of a component while all others are
held: the jackknife does not see it in a component whose estimate stays at zero.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import nnls

from slam.common.arrays import FloatArray, IntArray
from slam.self_calibration.displacement_outliers import without_outliers
from slam.self_calibration.object_tracks import ObjectTracks

BLOCKS = 8
"""Stretches of the log that the jackknife leaves out one at a time."""
CLIP = 8.0
"""Displacements are clipped at that many robust standard deviations."""
ROOM_SIGMAS = 4.0
"""Room of a track that its noise does not fill, in robust standard deviations of its steps."""
LEAST_SHARE = 0.25
LEAST_PAIRS = 100
"""Lags with fewer tracked pairs are left out."""
EXACT = 1e-18
"""Mean squares below that [m^2] are rounding: the log has no noise there."""
LEAST_IN_BIN = 20
COMPONENTS = 12


@dataclass(frozen=True, slots=True)
class NoiseComponents:
    """Variances: of a detection along and across the ray, [m^2] and by range [m^2 / m^2], by the change of the viewing
    direction [m^2 / rad]; of the odometry's jitter, [m^2] and [rad^2]; of its drift by travel, turn and time.
    """

    radial: float
    radial_by_range: float
    tangential: float
    tangential_by_range: float
    view: float
    jitter: float
    translation_by_travel: float
    translation_by_time: float
    heading_jitter: float
    heading_by_travel: float
    heading_by_turn: float
    heading_by_time: float


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Travel [m], turn [rad] and time [s] up to each scan (K,), for their differences."""

    travel_m: FloatArray
    turn_rad: FloatArray
    time_s: FloatArray


@dataclass(frozen=True, slots=True)
class ComponentEstimate:
    """``variances`` with their ``standard_errors``; from ``pairs`` tracked pairs of detections.

    ``repeated``: so many scans in a row repeat what is said to be of a single one, as where a tracker fills in scans.
    """

    variances: NoiseComponents
    standard_errors: NoiseComponents
    pairs: int
    repeated: int = 1

    def white(self, square_range: float) -> tuple[float, float]:
        """Variance [m^2] of what a detection does not share with others, at a squared range, and its standard error."""
        variance, error = (
            0.5 * (each.radial + each.tangential + (each.radial_by_range + each.tangential_by_range) * square_range)
            for each in (self.variances, self.standard_errors)
        )
        return variance, error


def estimate_components(tracks: ObjectTracks, motion: Motion, *, most_repeated: int = 1) -> ComponentEstimate | None:
    """Variance components of a log; None where too few objects could be tracked, or at absurd distances.

    ``most_repeated``: scans up to so many apart may repeat their errors. Errors that are repeated hardly change from
    scan to scan; every second, fourth, ... scan alone shows them.
    """
    found = []
    for power in range(max(most_repeated, 1).bit_length()):
        estimate = _estimate(tracks.of(tracks.scan % 2**power == 0), motion)
        if estimate is None:
            break
        found.append(replace(estimate, repeated=2**power))
    if not found:
        return None
    whites = [each.white(float(np.mean(tracks.offsets**2)) * 2.0) for each in found]
    least = 0.5 * max(variance - error for variance, error in whites)
    return next(each for each, (variance, error) in zip(found, whites, strict=True) if variance + error >= least)


def _estimate(tracks: ObjectTracks, motion: Motion) -> ComponentEstimate | None:
    tracks = _well_apart(tracks)
    sums = [_equations(tracks, motion, first, second) for first, second in _lagged_pairs(tracks)]
    if not sums:
        return None
    totals = np.concatenate(sums, axis=1)  # (BLOCKS, equations, COMPONENTS + 2)
    if not np.isfinite(totals).all():
        return None
    solution, misfit = solve_components(totals.sum(axis=0))
    left_out = np.array([solve_components(np.delete(totals, block, axis=0).sum(axis=0))[0] for block in range(BLOCKS)])
    with np.errstate(over="ignore", invalid="ignore"):
        spread = np.sqrt((BLOCKS - 1) / BLOCKS * np.sum((left_out - left_out.mean(axis=0)) ** 2, axis=0))
    spread = np.maximum(spread, misfit)
    if not np.isfinite([solution, spread]).all():
        return None
    pairs = int(totals[:, :, -1].sum())
    return ComponentEstimate(NoiseComponents(*solution.tolist()), NoiseComponents(*spread.tolist()), pairs)


def _well_apart(tracks: ObjectTracks) -> ObjectTracks:
    """The tracks that had room for all the noise there is: those between near neighbours end where it is large.

    Where there are few of them, the quarter of the detections with the most room stands for them.
    """
    same = tracks.track[1:] == tracks.track[:-1]
    steps = (tracks.points[1:] - tracks.points[:-1])[same]
    if not len(steps):
        return tracks
    _, start, row = np.unique(tracks.track, return_index=True, return_inverse=True)
    room = np.minimum.reduceat(tracks.rooms, start)[row]
    sigma = 1.4826 * float(np.median(np.abs(steps)))
    kept = room >= min(ROOM_SIGMAS * sigma, float(np.quantile(room, 1.0 - LEAST_SHARE, method="lower")))
    return tracks.of(kept)


def _lagged_pairs(tracks: ObjectTracks) -> Iterator[tuple[IntArray, IntArray]]:
    """Rows (P,) of detections of one track that are 1, 2, 4, ... detections apart, as long as there are enough."""
    lag = 1
    while True:
        first = tracks.followed(lag)
        if len(first) < LEAST_PAIRS:
            return
        yield first, first + lag
        lag *= 2


def _equations(tracks: ObjectTracks, motion: Motion, first: IntArray, second: IntArray) -> FloatArray:
    """Sums (BLOCKS, E, COMPONENTS + 2) of the equations of one lag: regressors, value, count."""
    d = _clipped(tracks.points[second] - tracks.points[first])
    x, x_before = tracks.offsets[second], tracks.offsets[first]
    scan, scan_before = tracks.scan[second], tracks.scan[first]
    d = without_outliers(d, x, scan * (int(scan.max()) + 1) + scan_before)
    L, A, T = (each[scan] - each[scan_before] for each in (motion.travel_m, motion.turn_rad, motion.time_s))
    block = np.minimum(scan * BLOCKS // (int(tracks.scan.max()) + 1), BLOCKS - 1)
    return np.concatenate(
        [
            _own_equations(d, x, x_before, L, A, T, block),
            _cross_equations(d, x, x_before, scan, scan_before, L, A, T, block),
        ],
        axis=1,
    )


def _own_equations(
    d: FloatArray,
    x: FloatArray,
    x_before: FloatArray,
    L: FloatArray,
    A: FloatArray,
    T: FloatArray,
    block: IntArray,
) -> FloatArray:
    """What single objects say, in bins of range and of turn."""
    square, square_before = (np.einsum("ni,ni->n", each, each) for each in (x, x_before))
    r = np.sqrt(np.maximum(square, 1e-12))
    radial = np.einsum("ni,ni->n", d, x) / r
    tangential = (x[:, 0] * d[:, 1] - x[:, 1] * d[:, 0]) / r
    angle = np.arctan2(x[:, 1], x[:, 0]) - np.arctan2(x_before[:, 1], x_before[:, 0])
    view = np.abs((angle + np.pi) % (2.0 * np.pi) - np.pi)
    zero, one, ranges = np.zeros_like(r), np.ones_like(r), square + square_before
    ahead = np.einsum("ni,ni->n", x_before, x) / r
    beside = (x[:, 0] * x_before[:, 1] - x[:, 1] * x_before[:, 0]) / r
    lever, lever_beside = (ahead**2 + ahead * r + square) / 3.0, beside**2 / 3.0
    translation = [2.0 * one, L, T]
    heading = [square + ahead**2, lever * L, lever * A, lever * T]
    heading_beside = [beside**2, lever_beside * L, lever_beside * A, lever_beside * T]
    along = np.stack([2.0 * one, ranges, zero, zero, view, *translation, *heading_beside, radial**2], axis=1)
    across = np.stack([zero, zero, 2.0 * one, ranges, view, *translation, *heading, tangential**2], axis=1)
    bins = _bin(square, (1 / 3, 2 / 3)) * 3 + _bin(A, (0.5, 0.85))
    return np.concatenate([_binned(each, one, bins, block, 9) for each in (along, across)], axis=1)


def _cross_equations(
    d: FloatArray,
    x: FloatArray,
    x_before: FloatArray,
    scan: IntArray,
    scan_before: IntArray,
    L: FloatArray,
    A: FloatArray,
    T: FloatArray,
    block: IntArray,
) -> FloatArray:
    """What pairs of objects of the same two scans have in common, in bins of turn."""
    key = scan * (int(scan.max()) + 1) + scan_before
    _, start, group, count = np.unique(key, return_index=True, return_inverse=True, return_counts=True)

    def total(values: FloatArray) -> FloatArray:
        return np.bincount(group, values, minlength=len(start)).astype(np.float64)

    def of_pairs(first: FloatArray, second: FloatArray) -> FloatArray:
        """Sum over ordered pairs (k, l) of first_k . second_l, for vectors (N, D)."""
        sums = [total(first[:, i]) * total(second[:, i]) for i in range(first.shape[1])]
        return np.asarray(sum(sums) - total(np.einsum("ni,ni->n", first, second)))

    torque = (x[:, 0] * d[:, 1] - x[:, 1] * d[:, 0])[:, None]
    square = np.einsum("ni,ni->n", x, x)[:, None]
    ahead = np.einsum("ni,ni->n", x_before, x)[:, None]
    shifts, torques = of_pairs(d, d), of_pairs(torque, torque)
    at_ends = of_pairs(x, x) + of_pairs(x_before, x_before)
    on_the_way = (at_ends + of_pairs(x_before, x)) / 3.0
    squares_at_ends = of_pairs(square, square) + of_pairs(ahead, ahead)
    squares_on_the_way = (squares_at_ends + of_pairs(ahead, square)) / 3.0
    offsets = of_pairs(x, x)
    squares = of_pairs(square, square)
    pairs = (count * (count - 1)).astype(np.float64)
    L, A, T, block = L[start], A[start], T[start], block[start]
    zero, one = np.zeros_like(L), np.ones_like(L)

    def equation(by_shift: FloatArray, by_jitter: FloatArray, by_turn: FloatArray, value: FloatArray) -> FloatArray:
        common = [by_shift * each for each in (2.0 * one, L, T)] + [by_jitter] + [by_turn * each for each in (L, A, T)]
        return np.stack([zero] * 5 + [*common, value], axis=1)

    several = pairs > 0.0
    bins = np.where(several, _bin(A, (1 / 3, 2 / 3, 0.9)), -1)
    return np.concatenate(
        [
            _binned(equation(2.0 * pairs, at_ends, on_the_way, shifts), 2.0 * pairs, bins, block, 4),
            # Torques are divided by the mean squared range, so that all equations have one unit.
            _binned(
                equation(offsets, squares_at_ends, squares_on_the_way, torques),
                squares / float(square.mean()),
                bins,
                block,
                4,
            ),
        ],
        axis=1,
    )


def _binned(rows: FloatArray, weights: FloatArray, bins: IntArray, block: IntArray, count: int) -> FloatArray:
    """Sums (BLOCKS, count, COMPONENTS + 2) of rows (P, COMPONENTS + 1) scaled to a mean weight of 1, and how many."""
    used = bins >= 0
    scale = np.zeros(count)
    np.add.at(scale, bins[used], weights[used])
    numbers = np.bincount(bins[used], minlength=count)
    scale = np.where(numbers >= LEAST_IN_BIN, numbers / np.maximum(scale, 1e-300), 0.0)
    sums = np.zeros((BLOCKS, count, COMPONENTS + 2))
    np.add.at(sums, (block[used], bins[used]), np.column_stack([rows[used], np.ones(int(used.sum()))]))
    sums[:, :, :-1] *= scale[:, None]
    return sums


def solve_components(sums: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Variances (COMPONENTS,) from the summed equations (E, COMPONENTS + 2); their errors while the others are held."""
    counts = sums[:, -1]
    used = counts >= LEAST_IN_BIN
    if not used.any():
        return np.zeros(COMPONENTS), np.zeros(COMPONENTS)
    means = sums[used, :-1] / counts[used, None]
    X, y = means[:, :-1], means[:, -1]
    # The relative sampling error of a mean square of n values is sqrt(2 / n).
    weights = np.sqrt(counts[used]) / np.maximum(np.abs(y), EXACT)
    weights = np.minimum(weights, 10.0 * np.median(weights))
    norms = np.linalg.norm(X * weights[:, None], axis=0)
    scale = np.where(norms > 0.0, norms, np.inf)
    solution, misfit = nnls(X * weights[:, None] / scale, y * weights)
    return np.asarray(solution / scale), misfit / np.sqrt(max(len(y) - COMPONENTS, 1)) / scale


def _clipped(d: FloatArray) -> FloatArray:
    lengths = np.hypot(d[:, 0], d[:, 1])
    limit = CLIP * 1.4826 * float(np.median(np.abs(d)))
    return np.asarray(d * np.minimum(1.0, limit / np.maximum(lengths, 1e-300))[:, None])


def _bin(values: FloatArray, quantiles: tuple[float, ...]) -> IntArray:
    return np.digitize(values, np.quantile(values, quantiles)).astype(np.int64)
