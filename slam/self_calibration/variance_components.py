"""The noise of odometry and detections, from how far tracked objects seem to move: robust maximum likelihood.

An object that stands still seems to move by d_k between two scans, in the odometry frame. The objects of two scans have
the error xi of the odometry between them in common, a turn about each axis and a shift,

    d_k = A_k xi + e_k,    xi ~ N(0, Q / w_g),    e_k ~ N(0, D_k / w_k),

with A_k by the offset of the object from the body, half-way between the scans. The diagonal matrices D_k, along the
ray, across it and in height, and Q are linear in the variances (:class:`NoiseComponents`) by ranges, the angle b
between the two rays, change of the view B (:func:`view_change`), which turning on the spot leaves as it is, travel L,
turn A and time T. With the noise of a detection at range r along its ray, R = v_r + u_r r^2, and across it,
S = v_t + u_t r^2:

    D:  R1 cos^2 b + S1 sin^2 b + R2 + w B;   S1 cos^2 b + R1 sin^2 b + S2 + w B;   2 h + w_z B
    Q:  2 j_t + a_t L + b_t T + s V / 2 for a shift along the ground, 2 j_z + a_z L for one in height;
        2 j_y + a_y L + c_y A + b_y T + s W for the heading, 2 j_x + a_x L for roll and pitch,

with the variance s of stamps and the sums V and W of the squared speeds and turn rates at the two scans.

Drift in heading on the way also shifts objects across the motion: a seventh entry of xi. The weights w are those of
Student's t-distributions, so that slips (of all objects of two scans) and wrong matches (of one) count little. The
variances are the fixed point of theta_i <- theta_i (d' S^-1 V_i S^-1 d) / tr(S^-1 V_i), with S = sum theta_i V_i the
covariance of all d of two scans (Zhou et al., MM algorithms for variance components models, JCGS 2019); S^-1 is found
through the seven entries of xi. Pairs of scans are 1, 2, 4, ... detections of a track apart.

Standard errors are the larger of two: by leaving out a block of time at a time (the jackknife), and by the information
that the pairs have of a component while all others are held.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.sparse import csr_array
from scipy.special import roots_genlaguerre

from logs.records import frozen
from slam.common.arrays import FloatArray, IntArray
from slam.common.geometry import skew, travelled_m, view_change
from slam.odometry.noise import FREEDOM
from slam.self_calibration.object_tracks import ROUNDING, ObjectTracks

BLOCKS = 8
"""Stretches of the log that the jackknife leaves out one at a time."""
ITERATIONS = 50
QUADRATURE = 32
"""Nodes of the Gauss-Laguerre quadrature."""
USED_PAIRS = 3000
"""Pairs of detections of one lag that are used, at least, where there are more: all those of some pairs of scans."""
CLIP = 8.0
"""Displacements are clipped at that many robust standard deviations."""
ROOM_SIGMAS = 4.0
"""Room of a track that its noise does not fill, in robust standard deviations of its steps."""
LEAST_SHARE = 0.25
LEAST_PAIRS = 100
"""Lags with fewer tracked pairs are left out."""
MAX_UNIT_M = 1e100
"""Distances beyond that overflow where they are squared."""
OWN, SHARED = 7, 12
"""Numbers of the components of single detections, and of the odometry."""
TILT, HEADING, ALONG, RISE, LATERAL = slice(0, 2), 2, slice(3, 5), 5, 6
"""Entries of xi."""


@frozen
class NoiseComponents:
    """Variances: of a detection along and across the ray, [m^2] and by range [m^2 / m^2], of its height
    [m^2], by the change of the view along the ground and in height [m^2 / rad]; of the odometry's jitter,
    [m^2] and [rad^2], and of its drift by travel, turn and time; of the stamps of detections against it [s^2].
    """

    radial: float = 0.0
    radial_by_range: float = 0.0
    tangential: float = 0.0
    tangential_by_range: float = 0.0
    height: float = 0.0
    view: float = 0.0
    view_height: float = 0.0
    jitter: float = 0.0
    translation_by_travel: float = 0.0
    translation_by_time: float = 0.0
    rise: float = 0.0
    rise_by_travel: float = 0.0
    heading_jitter: float = 0.0
    heading_by_travel: float = 0.0
    heading_by_turn: float = 0.0
    heading_by_time: float = 0.0
    stamps: float = 0.0
    tilt_jitter: float = 0.0
    tilt_by_travel: float = 0.0


LENGTH_POWERS = np.array([2, 0, 2, 0, 2, 2, 2, 2, 1, 2, 2, 1, 0, -1, 0, 0, 0, 0, -1])
"""With which power of the unit of length each variance scales."""


@frozen
class Motion:
    """Travel [m], heading [rad] and time [s] of each scan (K,), for their differences; ``height_m`` (K,) of bodies."""

    travel_m: FloatArray
    heading_rad: FloatArray
    time_s: FloatArray
    height_m: FloatArray

    def rates(self) -> FloatArray:
        """Speed [m/s] and turn rate [rad/s] at each scan (K, 2); 0 where the time stands still."""
        step, seconds = np.gradient([self.travel_m, self.heading_rad], axis=1), np.gradient(self.time_s)
        return np.divide(step, seconds, out=np.zeros_like(step), where=seconds > 0.0).T


@frozen
class ComponentEstimate:
    """``variances`` with their ``standard_errors``; from ``pairs`` tracked pairs of detections."""

    variances: NoiseComponents
    standard_errors: NoiseComponents
    pairs: int

    def white(self, square_range: float) -> float:
        """Variance [m^2] of what a detection does not share with others, at a squared range."""
        own = self.variances
        return 0.5 * (own.radial + own.tangential + (own.radial_by_range + own.tangential_by_range) * square_range)


def estimate_components(tracks: ObjectTracks, motion: Motion) -> ComponentEstimate | None:
    """Variance components of a log; None where too few objects could be tracked, or at absurd distances."""
    pairs = _displacements(_well_apart(tracks), motion)
    if pairs is None:
        return None
    fit = _Fit(pairs)
    for _ in range(ITERATIONS):
        fit.step()
    scale = pairs.unit_m**LENGTH_POWERS
    values, errors = fit.variances * scale, fit.standard_errors() * scale
    if not np.isfinite([values, errors]).all():
        return None
    variances = NoiseComponents(*values.tolist())
    if not _has_heights(pairs):
        variances = replace(variances, height=0.5 * float(np.mean((pairs.d[:, 2] * pairs.unit_m) ** 2)))
    return ComponentEstimate(variances, NoiseComponents(*errors.tolist()), len(pairs.d))


def _well_apart(tracks: ObjectTracks) -> ObjectTracks:
    """The tracks that had room for all the noise there is: those between near neighbours end where it is large.

    Where there are few of them, the quarter of the detections with the most room is used instead.
    """
    same = tracks.track[1:] == tracks.track[:-1]
    steps = tracks.steps[1:][same]
    if not len(steps):
        return tracks
    _, start, row = np.unique(tracks.track, return_index=True, return_inverse=True)
    room = np.minimum.reduceat(tracks.rooms, start)[row]
    sigma = np.median(steps) / 1.1774
    kept = room >= min(ROOM_SIGMAS * sigma, np.quantile(room, 1.0 - LEAST_SHARE, method="lower"))
    return tracks.of(kept)


@frozen
class _Displacements:
    """Displacements of objects between two scans, ordered by the pair of scans, all lengths in units of ``unit_m``.

    ``d``, ``x``, ``x_before`` (P, 3): displacement, and offset of the object from the body in the second and the first
    scan; ``group`` (P,): the pair of scans; ``moved`` (G, 3): travel, turn and time between them; ``rates`` (G, 2): the
    squared speeds and turn rates at the two, added; ``block`` (G,).
    """

    d: FloatArray
    x: FloatArray
    x_before: FloatArray
    group: IntArray
    moved: FloatArray
    rates: FloatArray
    block: IntArray
    unit_m: float


def _displacements(tracks: ObjectTracks, motion: Motion) -> _Displacements | None:
    """None where objects are followed too seldom, or too far away."""
    lags = list(_lagged_pairs(tracks))
    if not lags:
        return None
    first, second = (np.concatenate(each) for each in zip(*lags, strict=True))
    unit_m = np.median(np.hypot(*tracks.offsets.T))
    if not 1.0 / MAX_UNIT_M < unit_m < MAX_UNIT_M:
        return None
    lag = np.repeat(np.arange(len(lags)), [len(each) for each, _ in lags])
    scans = int(tracks.scan.max()) + 1
    key = (lag * scans + tracks.scan[first]) * scans + tracks.scan[second]
    order = np.argsort(key, kind="stable")
    first, second = first[order], second[order]
    _, start, group = np.unique(key[order], return_index=True, return_inverse=True)
    before, after = tracks.scan[first], tracks.scan[second]
    places = tracks.places
    offsets = np.column_stack([tracks.offsets, tracks.heights - motion.height_m[tracks.scan]])
    totals = motion.travel_m, travelled_m(motion.heading_rad[:, None]), motion.time_s
    moved = np.stack([each[after] - each[before] for each in totals], axis=1)
    moved = moved[start] / [unit_m, 1.0, 1.0]
    squares = motion.rates() ** 2
    rates = (squares[before] + squares[after])[start] / [unit_m**2, 1.0]
    block = np.minimum(before[start] * BLOCKS // scans, BLOCKS - 1)
    d, x, x_before = (each / unit_m for each in (places[second] - places[first], offsets[second], offsets[first]))
    return _Displacements(d, x, x_before, group, moved, rates, block, unit_m)


def _lagged_pairs(tracks: ObjectTracks) -> Iterator[tuple[IntArray, IntArray]]:
    """Rows (P,) of detections of one track that are 1, 2, 4, ... detections apart, as long as there are enough.

    Of the pairs of scans of one lag those that begin in every so many scans are used.
    """
    lag = 1
    while True:
        first, second = tracks.pairs(lag)
        if len(first) < LEAST_PAIRS:
            return
        begins = np.unique(tracks.scan[first])
        is_used = np.isin(tracks.scan[first], begins[:: max(len(first) // USED_PAIRS, 1)])
        yield first[is_used], second[is_used]
        lag *= 2


class _Fit:
    """The variances by displacements, in their units; ``step`` makes them likelier."""

    def __init__(self, pairs: _Displacements) -> None:
        self._pairs = pairs
        self._group, self._start = pairs.group, np.flatnonzero(np.diff(pairs.group, prepend=-1))
        axes = _axes(pairs)
        self._A = axes @ _jacobians(pairs)
        self._products = np.einsum("ndi,ndj->ndij", self._A, self._A)
        y = np.einsum("nij,nj->ni", axes, pairs.d)
        limit = CLIP * 1.4826 * np.median(np.abs(y), axis=0)
        self._y = np.where(limit > 0.0, np.clip(y, -limit, limit), y)
        own, shared = _own_parts(pairs)[:, :, : axes.shape[1]], _shared_parts(pairs)
        self._parts = own, shared
        square = max(np.mean(self._y**2), ROUNDING)
        # Mean squares (G, 7) of the displacement by one unit of each entry of xi.
        counts = np.diff(np.append(self._start, len(self._y)))[:, None]
        levers = np.add.reduceat((self._A**2).mean(axis=1), self._start, axis=0) / counts
        sums = np.concatenate([own.mean(axis=(1, 2)), (shared * levers).sum(axis=2).mean(axis=1)])
        share = 1.0 / (OWN + SHARED)
        self.variances = np.where(sums > 0.0, share * square / np.maximum(sums, 1e-300), 0.0)
        self._weights = np.ones(len(self._y)), np.ones(len(self._start))

    def step(self) -> None:
        """One iteration: variances by the displacements as they are weighted, and the weights by these."""
        fitted, expected = (each.sum(axis=1) for each in self._sums())
        ratios = np.where(expected > 0.0, fitted / np.maximum(expected, 1e-300), 1.0)
        self.variances = self.variances * np.clip(ratios, 1e-2, 1e2)

    def standard_errors(self) -> FloatArray:
        """(19,) of the variances."""
        fitted, expected = self._sums()
        # Of each component without a block of the log, by one more iteration.
        total = expected.sum(axis=1, keepdims=True)
        rest = total - expected
        is_known = rest > ROUNDING * total
        without = np.where(is_known, fitted.sum(axis=1, keepdims=True) - fitted, 1.0) / np.where(is_known, rest, 1.0)
        spread = np.sqrt((BLOCKS - 1) / BLOCKS * np.sum((without - without.mean(axis=1, keepdims=True)) ** 2, axis=1))
        return np.maximum(self.variances * spread, self._held_errors)

    def _sums_of_groups(self, weights: FloatArray, values: FloatArray) -> FloatArray:
        """Sums (G, ...) of values (P, D, ...) times weights (P, D)."""
        rows = weights.size
        ends = np.append(self._start * weights.shape[1], rows)
        sums = csr_array((weights.ravel(), np.arange(rows), ends)) @ values.reshape(rows, -1)
        return sums.reshape(-1, *values.shape[2:])

    def _sums(self) -> tuple[FloatArray, FloatArray]:
        """For each component and block (19, BLOCKS) d' S^-1 V S^-1 d and tr(S^-1 V); updates the weights."""
        (own, shared), (weights, group_weights) = self._parts, self._weights
        A, y, group = self._A, self._y, self._group
        D = np.einsum("c,cnd->nd", self.variances[:OWN], own)
        Q = np.einsum("c,cgi->gi", self.variances[OWN:], shared)
        inverse = weights[:, None] / np.maximum(D, ROUNDING)
        M, v = self._sums_of_groups(inverse, self._products), self._sums_of_groups(inverse * y, A)
        root = np.sqrt(Q / group_weights[:, None])
        roots = root[:, :, None] * root[:, None, :]
        scaled = roots * M
        # Not singular by rounding, however much the variances differ.
        least = np.maximum(1.0, root.shape[1] * np.finfo(np.float64).eps * np.einsum("gii->g", scaled))
        C = roots * np.linalg.inv(least[:, None, None] * np.eye(7) + scaled)  # posterior covariance of xi
        xi = np.einsum("gij,gj->gi", C, v)
        e = y - np.einsum("ndi,ni->nd", A, xi[group])
        unknown = np.einsum("ndij,nij->nd", self._products, C[group])
        own_expected = np.maximum(inverse - inverse**2 * unknown, 0.0)
        shared_expected = np.maximum(np.einsum("gii->gi", M) - np.einsum("gij,gij->gi", M @ C, M), 0.0)
        of_own = [each / weights[:, None] for each in ((e * inverse) ** 2, own_expected)]
        of_shared = [
            each / group_weights[:, None] for each in ((v - np.einsum("gij,gj->gi", M, xi)) ** 2, shared_expected)
        ]
        block = self._pairs.block
        sums = [
            np.concatenate([_by_block(own, a, block[group]), _by_block(shared, b, block)])
            for a, b in zip(of_own, of_shared, strict=True)
        ]
        information = (own**2, of_own[1] ** 2), (shared**2, of_shared[1] ** 2)
        held = np.concatenate([0.5 * np.einsum("cnd,nd->c", *each) for each in information])
        self._held_errors = np.where(held > 0.0, 1.0 / np.sqrt(np.maximum(held, 1e-300)), 0.0)
        shares = [
            ((e**2 + unknown) * inverse / weights[:, None]).sum(axis=1),
            np.divide(xi**2 + np.einsum("gii->gi", C), Q, out=np.zeros_like(Q), where=Q > 0.0).sum(axis=1),
        ]
        sizes = y.shape[1], max(int((Q > 0.0).any(axis=0).sum()), 1)
        self._weights = _weights(shares[0], sizes[0]), _weights(shares[1], sizes[1])
        return sums[0], sums[1]


def _weights(squares: FloatArray, size: int) -> FloatArray:
    """Weights of Student's t-distribution for squared distances of vectors, 1 in the mean where these are Gaussian."""
    halves, shares = roots_genlaguerre(QUADRATURE, 0.5 * size - 1.0)  # of the chi-squared distribution
    mean = np.average(2.0 * halves * (FREEDOM + size) / (FREEDOM + 2.0 * halves), weights=shares)
    return size / mean * (FREEDOM + size) / (FREEDOM + squares)


def _by_block(parts: FloatArray, values: FloatArray, block: IntArray) -> FloatArray:
    """Sums (C, BLOCKS) of parts (C, N, D) of values (N, D) by the block (N,)."""
    sums = np.einsum("cnd,nd->cn", parts, values)
    return np.array([np.bincount(block, each, minlength=BLOCKS) for each in sums], dtype=np.float64)


def _axes(pairs: _Displacements) -> FloatArray:
    """(P, D, 3): along the ray, across it and, where heights differ, up."""
    r = np.maximum(np.hypot(pairs.x[:, 0], pairs.x[:, 1]), 1e-12)
    x, y, zero = pairs.x[:, 0] / r, pairs.x[:, 1] / r, np.zeros(len(r))
    axes = np.array([[x, y, zero], [-y, x, zero], [zero, zero, zero + 1.0]])
    return axes.transpose(2, 0, 1)[:, : 3 if _has_heights(pairs) else 2]


def _has_heights(pairs: _Displacements) -> bool:
    """Whether most objects change their height between two scans. Where they do not, as with rounded heights or a few
    faulty scans of a planar sensor, the scale of a robust fit is zero, and the fit diverges.
    """
    return bool(np.median(np.abs(pairs.d[:, 2])) > 1e-9)


def _jacobians(pairs: _Displacements) -> FloatArray:
    """(P, 3, 7) of the displacements by xi."""
    middle = 0.5 * (pairs.x + pairs.x_before)
    A = np.zeros((len(middle), 3, 7))
    A[:, :, :3] = -skew(middle)
    A[:, :, 3:6] = np.eye(3)
    A[:, :, LATERAL] = np.cross([0.0, 0.0, 1.0], pairs.x - pairs.x_before)
    return A


def _own_parts(pairs: _Displacements) -> FloatArray:
    """(7, P, 3): by how much a unit of each component adds to D."""
    squares = np.einsum("ni,ni->n", pairs.x, pairs.x), np.einsum("ni,ni->n", pairs.x_before, pairs.x_before)
    lengths = np.maximum(np.sqrt(squares[0] * squares[1]), 1e-300)
    travel = pairs.moved[pairs.group, 0]
    # Noise changes the view, too; the body has not come farther than its travel.
    view = np.minimum(view_change(pairs.x_before, pairs.x), travel / np.sqrt(lengths))
    two, zero = np.full_like(view, 2.0), np.zeros_like(view)
    flat, flat_before = pairs.x[:, :2], pairs.x_before[:, :2]
    products = np.maximum(np.linalg.norm(flat, axis=1) * np.linalg.norm(flat_before, axis=1), 1e-300)
    cos2 = np.minimum((np.einsum("ni,ni->n", flat, flat_before) / products) ** 2, 1.0)
    after, along, across = squares[0], squares[1] * cos2, squares[1] * (1.0 - cos2)
    parts = [
        [1.0 + cos2, 1.0 - cos2, zero],
        [after + along, across, zero],
        [1.0 - cos2, 1.0 + cos2, zero],
        [across, after + along, zero],
        [zero, zero, two],
        [view, view, zero],
        [zero, zero, view],
    ]
    return np.array(parts).transpose(0, 2, 1)


def _shared_parts(pairs: _Displacements) -> FloatArray:
    """(12, G, 7): by how much a unit of each component adds to Q."""
    L, A, T = pairs.moved.T
    V, W = pairs.rates.T
    two = np.full_like(L, 2.0)
    parts = np.zeros((SHARED, len(L), 7))
    parts[0:3, :, ALONG] = np.stack([two, L, T])[:, :, None]
    parts[3:5, :, RISE] = np.stack([two, L])
    parts[5:9, :, HEADING] = np.stack([two, L, A, T])
    # The heading errs at both ends, or more and more on the way.
    parts[5:9, :, LATERAL] = np.stack([0.25 * two, L / 12.0, A / 12.0, T / 12.0])
    parts[9, :, HEADING], parts[9, :, ALONG] = W, 0.5 * V[:, None]  # the direction of the speed may be any
    parts[10:12, :, TILT] = np.stack([two, L])[:, :, None]
    return parts
