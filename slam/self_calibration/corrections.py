"""Systematic errors of the input, from how tracked objects seem to move, and which of them predict what is held out.

An object at the offset x from the body at P, in the axes of the odometry, seems to stand at W = P + x. Assume that the
detections are later by tau than their stamps, that the sensor is turned by the rotation vector phi and sits farther by
e, both in the axes R of the body, that the odometry's lengths and turns are too short by the shares s and g, that it
climbs too little by a share a of its way, which is L so far, that it turns too little by k per metre of it and by d per
second, that detections lie too near by b and too low by a share c of their range. Then it stands, with v and omega the
velocity and rate of turn of the body, h the angle that it turned so far, u = x / |x| and J = [0 -1; 1 0], at

    W + tau (v + omega J x) + R phi x x + R e + s P + T(g h + k L + d t) + a L z + b u + c |x| z,
    T(f) = f J x + integral of f J v,

which does not move. Robust regression (Cauchy's weights) of the apparent motion between scans on the differences of all
terms finds them. A term is *earned* if blocks of the log that the regression was not fitted to are predicted better
with the term: among all others, which may replace it, and if it is corrected alone by its value there, since several
terms together fit what none of them explains; by a share of what is left, and more surely than chance, which gives each
block's gain either sign (the sign-flip test). The value of a term is what fits best without the others: where a robot
turns too little near objects, a sensor that is shifted and turns that are right in part fit together better, and are
both wrong.

A term *changes* at the begin of a block if a second value of it from there on is earned in the same way, beside all
terms.
"""

from collections.abc import Collection, Sequence
from dataclasses import replace
from itertools import product

import numpy as np
from scipy.special import stdtrit

from logs.records import frozen
from slam.common.arrays import BoolArray, FloatArray, IntArray
from slam.common.geometry import view_change
from slam.self_calibration.object_tracks import ObjectTracks
from slam.self_calibration.variance_components import BLOCKS as STRETCHES

TERMS = (
    "delay_s",
    "roll_rad",
    "pitch_rad",
    "yaw_rad",
    "length_share",
    "turn_share",
    "drift_rad_per_s",
    "curvature_rad_per_m",
    "climb_share",
    "x_m",
    "y_m",
    "near_m",
    "low_share",
)
BLOCKS = 14
"""Stretches of the log whose gains are independent; they are held out one at a time."""
CHANCE = 0.01
"""Probability by which chance, which gives each block's gain either sign, may gain as much."""
MIN_GAIN = 0.03
"""Share of the held-out squared motion that a correction must explain."""
MIN_PAIRS = 200
MAX_PAIRS = 100_000
"""More pairs of detections tell nothing new."""
ROUNDS = 10
CAUCHY = 2.0
LEAST_VIEW_CHANGE = 0.1
"""Rays that differ less do not determine the bias of centroids."""
J = np.array([[0.0, -1.0], [1.0, 0.0]])
_SIGNS = np.array(list(product((1.0, -1.0), repeat=BLOCKS)))


@frozen
class BodyMotion:
    """At each scan (K), in the axes of the odometry: ``positions`` (K, 3) m, ``headings`` (K,) rad, ``velocities``
    (K, 2) m/s, ``turn_rates`` (K,) rad/s; ``seconds`` (K,) since the first one and ``travels`` (K,) m until then.
    """

    positions: FloatArray
    headings: FloatArray
    velocities: FloatArray
    turn_rates: FloatArray
    seconds: FloatArray
    travels: FloatArray

    @property
    def growing(self) -> dict[str, FloatArray]:
        """What the heading lacks (K,) rad, by a unit of each term whose error of it grows."""
        return {"turn_share": self.headings, "drift_rad_per_s": self.seconds, "curvature_rad_per_m": self.travels}


@frozen
class Correction:
    """The ``value`` of a term without the others, and its ``value_among_all``, 0 where that may be chance (a jackknife
    over the blocks); ``gain``: share of the held-out motion that it explains, among all others and by its value there
    alone, the smaller one; ``is_sure``: whether both are more than chance gains.
    """

    term: str
    value: float
    gain: float
    is_sure: bool
    value_among_all: float = 0.0

    @property
    def is_earned(self) -> bool:
        """Whether it predicts what is held out, by much and surely, with and without all other terms."""
        return self.is_sure and self.gain >= MIN_GAIN


@frozen
class Change:
    """By how much the ``value`` of a term is larger from the scan ``scan`` (its number) on."""

    term: str
    value: float
    scan: int


@frozen
class Regression:
    """Normal matrices (B, T, T), right sides (B, T) and squared sides (B,) of the blocks, units (T,) of the terms, and
    the first scan (B,) of each block.
    """

    normal: FloatArray
    right: FloatArray
    squared: FloatArray
    scale: FloatArray
    scans: IntArray

    def held_out(self, used: BoolArray) -> tuple[FloatArray, FloatArray]:
        """What the terms ``used`` (T,) are without each block, (B, T), and the squared residuals (B,) of it then."""
        parts, total = np.zeros(self.right.shape), self.normal.sum(axis=0)
        least = max(1e-9 * np.trace(total), 1e-300) * np.eye(used.sum())
        others, sides = total - self.normal, self.right.sum(axis=0) - self.right
        parts[:, used] = np.linalg.solve(others[:, used][:, :, used] + least, sides[:, used, None])[..., 0]
        return parts, self.left_of(parts)

    def left_of(self, parts: FloatArray) -> FloatArray:
        """The squared residuals (B,) of each block, if the terms have the values ``parts`` (B, T)."""
        fitted = np.einsum("bt,btu,bu->b", parts, self.normal, parts)
        return self.squared - 2.0 * np.einsum("bt,bt->b", parts, self.right) + fitted

    def explains_most(self, terms: Sequence[str]) -> tuple[str, float]:
        """Of the terms the one that alone explains most of what is held out, with its value."""
        alone = {term: self.held_out(np.array(TERMS) == term) for term in terms}
        best = min(terms, key=lambda term: alone[term][1].sum())
        number = TERMS.index(best)
        return best, float(alone[best][0][:, number].mean() / self.scale[number])

    def is_chance(self, term: str, value: float) -> bool:
        """Whether a value found otherwise explains blocks no better than chance; not where they do not tell."""
        number = TERMS.index(term)
        parts = np.zeros((BLOCKS, len(TERMS)))
        parts[:, number] = value * self.scale[number]
        gain, is_sure = _gain(self.squared, self.left_of(parts))
        return gain != 0.0 and not is_sure


def estimate_corrections(
    tracks: ObjectTracks, motion: BodyMotion, absent: Collection[str] = ()
) -> tuple[Correction, ...]:
    """The terms, the one with the largest gain first; none where too few objects could be tracked.

    ``absent``: terms that are 0, as another one that looks like them was found.
    """
    regression = regress(tracks, motion)
    if regression is None:
        return ()
    everything = np.array([term not in absent for term in TERMS])
    parts, with_all = regression.held_out(everything)
    error = np.sqrt(BLOCKS - 1) * np.std(parts, axis=0)
    may_be_0 = np.abs(parts.mean(axis=0)) <= stdtrit(BLOCKS - 1, 1.0 - 0.5 * CHANCE) * error
    among_all = np.where(may_be_0, 0.0, parts.mean(axis=0) / regression.scale)
    found = []
    for number in np.flatnonzero(everything).tolist():
        is_term = np.arange(len(TERMS)) == number
        _, without = regression.held_out(everything & ~is_term)
        alone, _ = regression.held_out(is_term)
        gains, are_sure = zip(
            _gain(without, with_all), _gain(regression.squared, regression.left_of(parts * is_term)), strict=True
        )
        values = alone[:, number] / regression.scale[number]
        found.append(Correction(TERMS[number], values.mean(), min(gains), all(are_sure), among_all[number]))
    return tuple(sorted(found, key=lambda each: -each.gain))


def find_change(tracks: ObjectTracks, motion: BodyMotion) -> Change | None:
    """The change of a term that explains most, if it is earned. Each value must be held out, so that it has two blocks
    at least.
    """
    regression = regress(tracks, motion)
    if regression is None:
        return None
    everything = np.ones(len(TERMS) + 1, dtype=np.bool_)
    _, before = regression.held_out(everything[1:])
    best, most = None, MIN_GAIN
    for number, start in product(range(len(TERMS)), range(2, BLOCKS - 1)):
        columns = [*range(len(TERMS)), number]
        later = np.ones((BLOCKS, len(columns)))
        later[:start, -1] = 0.0
        both = regression.normal[:, columns][:, :, columns] * later[:, :, None] * later[:, None, :]
        changing = replace(regression, normal=both, right=regression.right[:, columns] * later)
        parts, after = changing.held_out(everything)
        gain, is_sure = _gain(before, after)
        if is_sure and gain >= most:
            value = parts[:, -1].mean() / regression.scale[number]
            best, most = Change(TERMS[number], value, int(regression.scans[start])), gain
    return best


def regress(tracks: ObjectTracks, motion: BodyMotion) -> Regression | None:
    """Apparent motion by the differences of all terms; None where too few objects could be tracked."""
    first, second = tracks.pairs(2, 4, 8, 16)
    every = max(-(-len(first) // MAX_PAIRS), 1)
    first, second = first[::every], second[::every]
    if len(first) < MIN_PAIRS or _views(tracks) < BLOCKS:
        return None
    effects = _effects(tracks, motion)
    X = effects[first] - effects[second]  # (P, 3, terms)
    # Turns before the first scan of a pair would multiply the errors of its offsets: they turn all that comes after.
    at = motion.positions[tracks.scan, :2] + tracks.offsets
    for term, lacking in motion.growing.items():
        X[:, :2, TERMS.index(term)] -= lacking[tracks.scan[first], None] * ((at[first] - at[second]) @ J.T)
    y = tracks.places[second] - tracks.places[first]
    block = np.argsort(np.argsort(tracks.scan[second], kind="stable")) * BLOCKS // len(second)
    scale = np.maximum(np.sqrt(np.mean(X**2, axis=(0, 1))), 1e-300)
    scans = np.sort(tracks.scan[second])[np.searchsorted(np.sort(block), np.arange(BLOCKS))]
    return Regression(*_block_sums(X / scale, y, block), scale, scans)


def _views(tracks: ObjectTracks) -> float:
    """How many views of objects there are that do not share their errors: those of each track, by changes of 1 rad."""
    offsets = np.column_stack([tracks.offsets, np.zeros(len(tracks.offsets))])
    changes = view_change(*(offsets[rows] for rows in tracks.pairs(1)))
    return len(np.unique(tracks.track)) + float(changes.sum())


def is_beyond_chance(gains: FloatArray) -> bool:
    """Whether the sum of the gains (BLOCKS,) is more than chance, by the sign-flip test."""
    return bool(np.mean(_SIGNS @ gains >= gains.sum() * (1.0 - 1e-12)) <= CHANCE)


def _gain(before: FloatArray, after: FloatArray) -> tuple[float, bool]:
    """The share by which squared residuals (B,) of blocks are less, and whether that is more than chance."""
    gains = before - after
    return gains.sum() / max(before.sum(), 1e-300), is_beyond_chance(gains)


def _effects(tracks: ObjectTracks, motion: BodyMotion) -> FloatArray:
    """(S, 3, terms): by how much each point moves for a unit of each term."""
    positions, headings = motion.positions[tracks.scan], motion.headings[tracks.scan]
    offsets = np.column_stack([tracks.offsets, tracks.heights - positions[:, 2]])
    turned = tracks.offsets @ J.T
    c, s, zero = np.cos(headings), np.sin(headings), np.zeros(len(headings))
    along, across = np.column_stack([c, s, zero]), np.column_stack([-s, c, zero])
    steps = np.diff(motion.positions[:, :2], axis=0, prepend=motion.positions[:1, :2])
    ranges = np.linalg.norm(tracks.offsets, axis=1)
    level = {
        "delay_s": motion.velocities[tracks.scan] + motion.turn_rates[tracks.scan][:, None] * turned,
        "yaw_rad": turned,
        "near_m": tracks.rays,
    }
    for term, lacking in motion.growing.items():
        swept = np.cumsum(lacking[:, None] * (steps @ J.T), axis=0)
        level[term] = lacking[tracks.scan, None] * turned + swept[tracks.scan]
    in_space = {name: np.column_stack([effect, zero]) for name, effect in level.items()} | {
        "roll_rad": np.cross(along, offsets),
        "pitch_rad": np.cross(across, offsets),
        "length_share": positions,
        "climb_share": np.column_stack([zero, zero, motion.travels[tracks.scan]]),
        "x_m": along,
        "y_m": across,
        "low_share": np.column_stack([zero, zero, ranges]),
    }
    return np.stack([in_space[term] for term in TERMS], axis=2)


def _block_sums(X: FloatArray, y: FloatArray, block: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Normal matrices (B, T, T), right sides (B, T) and squared sides (B,) of robust regression, block by block.

    Along the ground and in height residuals have scales of their own; heights that never change tell nothing.
    """
    size = X.shape[2]
    left = y
    for _ in range(ROUNDS):
        squares = np.column_stack([np.sum(left[:, :2] ** 2, axis=1), left[:, 2] ** 2])
        spread = np.median(squares, axis=0)
        inverse = np.where(spread > 1e-12 * spread.max(), 1.0 / np.maximum(spread, 1e-300), 0.0)
        weights = 1.0 / (1.0 + squares @ inverse / CAUCHY**2)
        level, up = weights * inverse[0], weights * inverse[1]
        root = np.sqrt(np.column_stack([level, level, up]))
        rows, sides = (root[:, :, None] * X).reshape(-1, size), (root * y).reshape(-1)
        normal = rows.T @ rows
        ridge = 1e-9 * np.trace(normal) * np.eye(size)
        solution = np.linalg.lstsq(normal + ridge, rows.T @ sides)[0]
        left = y - X @ solution
    of_row = np.repeat(block, 3)
    blocks = [(rows[of_row == each], sides[of_row == each]) for each in range(BLOCKS)]
    normals = np.stack([X.T @ X for X, _ in blocks])
    right = np.stack([X.T @ y for X, y in blocks])
    return normals, right, np.asarray(np.bincount(of_row, sides**2, BLOCKS), dtype=np.float64)


def centroid_biases(tracks: ObjectTracks) -> FloatArray:
    """Bias (C,) m of observed centroids towards the sensor, of each class; 0 where there is none that is significant.

    Only the near half of an object is visible, so that its centroid is too near by some b: it is at p and is seen at
    p - b u, u the unit vector of the viewing ray. Between two scans with rays u1 and u2 it seems to move by
    -b (u2 - u1), which regression finds (robustly, by Cauchy's weights). All objects of a class share b, and so its
    error: it does not average out over the objects in view.
    """
    biases = np.zeros(tracks.labels.max(initial=-1) + 1)
    first, second = tracks.pairs(4, 8, 16)
    is_turned = np.linalg.norm(tracks.rays[second] - tracks.rays[first], axis=1) > LEAST_VIEW_CHANGE
    first, second = first[is_turned], second[is_turned]
    turned = tracks.rays[first] - tracks.rays[second]
    moved = tracks.points[second] - tracks.points[first]
    block = tracks.scan[second] * STRETCHES // (tracks.scan.max(initial=0) + 1)
    for label in range(len(biases)):
        chosen = tracks.labels[first] == label
        blocks = np.unique(block[chosen])
        if np.count_nonzero(chosen) < MIN_PAIRS or len(blocks) < STRETCHES // 2:
            continue
        found = _slope(turned[chosen], moved[chosen])
        others = (chosen & (block != each) for each in blocks)
        error = np.sqrt(len(blocks) - 1) * np.std([_slope(turned[each], moved[each]) for each in others])
        biases[label] = found if found > 4.0 * error else 0.0
    return biases


def without_bias(tracks: ObjectTracks, biases: FloatArray) -> ObjectTracks:
    """The tracks with each detection moved outwards by the bias of its class."""
    outwards = biases[tracks.labels][:, None] * tracks.rays
    return replace(tracks, offsets=tracks.offsets + outwards, points=tracks.points + outwards)


def _slope(x: FloatArray, y: FloatArray) -> float:
    """Slope of y (P, 2) over x (P, 2), robustly."""
    x, y = x.ravel(), y.ravel()
    weights = np.ones_like(x)
    slope = 0.0
    for _ in range(ROUNDS):
        weighted = weights * x
        slope = np.sum(weighted * y) / max(np.sum(weighted * x), 1e-300)
        residuals = y - slope * x
        scale = CAUCHY * 1.4826 * np.median(np.abs(residuals)) + 1e-12
        weights = 1.0 / (1.0 + (residuals / scale) ** 2)
    return slope
