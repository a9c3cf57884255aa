"""Systematic errors of the input, from how tracked objects seem to move: stamps, where the sensor sits, lengths.

An object at the offset x from the body at P, in the axes of the odometry, seems to stand at W = P + x. Say that the
detections are of a time later by tau than their stamps say, that the sensor is turned by phi and sits farther by e (in
the axes of the body, which heads along R) than its transform says, and that the odometry's lengths and turns are too
short by the shares s and g. Then it stands, with v and omega the velocity and rate of turn of the body, h the angle
that it turned so far and J = [0 -1; 1 0], at

    W + tau (v + omega J x) + phi J x + R e + s P + g (h J x + integral of h J v)

which does not move. Robust regression (Cauchy's weights) of the apparent motion between scans on the differences of the
six terms finds them all; the jackknife over blocks of time, of one Newton step each, says how surely.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam.common.arrays import FloatArray, IntArray
from slam.self_calibration.object_tracks import ObjectTracks

BLOCKS = 8
SIGNIFICANT = 6.0
"""Standard errors from which a correction is believed."""
LEAST_GAIN = 0.02
"""Share of the squared apparent motion that the corrections must explain."""
LEAST_PAIRS = 200
ROUNDS = 10
CAUCHY = 2.0
LAGS = (2, 4, 8, 16)
J = np.array([[0.0, -1.0], [1.0, 0.0]])


@dataclass(frozen=True, slots=True, eq=False)
class BodyMotion:
    """At each scan (K), in the axes of the odometry: ``positions`` (K, 2) m, ``headings`` (K,) rad, ``velocities``
    (K, 2) m/s and ``turn_rates`` (K,) rad/s.
    """

    positions: FloatArray
    headings: FloatArray
    velocities: FloatArray
    turn_rates: FloatArray


@dataclass(frozen=True, slots=True)
class InputErrors:
    """Corrections of the input: ``delay_s`` to the stamps of detections, ``yaw_rad``, ``x_m`` and ``y_m`` to where the
    sensor sits on the body, ``length_share`` and ``turn_share`` to the odometry's lengths and turns; 0 where none is
    significant.
    """

    delay_s: float = 0.0
    yaw_rad: float = 0.0
    length_share: float = 0.0
    x_m: float = 0.0
    y_m: float = 0.0
    turn_share: float = 0.0


def estimate_input_errors(tracks: ObjectTracks, motion: BodyMotion) -> InputErrors:
    """The corrections that a log asks for."""
    first, second = _lagged(tracks)
    if len(first) < LEAST_PAIRS:
        return InputErrors()
    effects = _effects(tracks, motion)
    X = effects[first] - effects[second]  # (P, 2, 6)
    y = tracks.points[second] - tracks.points[first]
    block = tracks.scan[second] * BLOCKS // (int(tracks.scan.max()) + 1)
    solution, weights, parts = _regress(X, y, block)
    if len(parts) < BLOCKS // 2:
        return InputErrors()
    errors = np.sqrt((len(parts) - 1) / len(parts) * np.sum((parts - np.mean(parts, axis=0)) ** 2, axis=0))
    left = y - X @ solution
    before = float(np.sum(weights[:, None] * y**2))
    gain = 1.0 - float(np.sum(weights[:, None] * left**2)) / max(before, 1e-300)
    if gain < LEAST_GAIN:
        return InputErrors()
    return InputErrors(*np.where(np.abs(solution) > SIGNIFICANT * errors, solution, 0.0).tolist())


def _lagged(tracks: ObjectTracks) -> tuple[IntArray, IntArray]:
    firsts, seconds = [], []
    for lag in LAGS:
        first = np.arange(max(len(tracks.track) - lag, 0))
        first = first[tracks.track[first] == tracks.track[first + lag]]
        firsts.append(first)
        seconds.append(first + lag)
    return np.concatenate(firsts), np.concatenate(seconds)


def _effects(tracks: ObjectTracks, motion: BodyMotion) -> FloatArray:
    """(S, 2, 6): by how much each point moves for a unit of each correction."""
    turned = tracks.offsets @ J.T
    late = motion.velocities[tracks.scan] + motion.turn_rates[tracks.scan][:, None] * turned
    c, s = np.cos(motion.headings[tracks.scan]), np.sin(motion.headings[tracks.scan])
    along, across = np.stack([c, s], axis=1), np.stack([-s, c], axis=1)
    steps = np.diff(motion.positions, axis=0, prepend=motion.positions[:1])
    swept = np.cumsum(motion.headings[:, None] * (steps @ J.T), axis=0)
    overturned = motion.headings[tracks.scan][:, None] * turned + swept[tracks.scan]
    return np.stack([late, turned, motion.positions[tracks.scan], along, across, overturned], axis=2)


def _regress(X: FloatArray, y: FloatArray, block: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Solution (6,) of y = X s, robustly, the weights (P,), and what the solution is without each block (B, 6)."""
    size = X.shape[2]
    scale = np.maximum(np.sqrt(np.mean(X**2, axis=(0, 1))), 1e-300)
    rows, sides = (X / scale).reshape(-1, size), y.reshape(-1)
    least = 1e-9 * len(y) * np.eye(size)
    weights, limit, left = np.ones(len(y)), np.inf, y
    solution = np.zeros(size)
    for _ in range(ROUNDS):
        weighted = rows.T * np.repeat(weights, 2)
        solution = np.linalg.solve(weighted @ rows + least, weighted @ sides)
        left = (sides - rows @ solution).reshape(-1, 2)
        squares = np.sum(left**2, axis=1)
        limit = CAUCHY**2 * float(np.median(squares)) + 1e-12
        weights = 1.0 / (1.0 + squares / limit)
    parts = solution + _changes(rows.reshape(X.shape), left, weights, limit, block)
    return solution / scale, weights, parts / scale


def _changes(X: FloatArray, left: FloatArray, weights: FloatArray, limit: float, block: IntArray) -> FloatArray:
    """By how much (B, 6) the solution changes without each block: Newton's step on the cost of all others.

    ``left`` (P, 2) are the residuals. The weight w = 1 / (1 + r^2 / limit) falls with the squared residual by
    w^2 / limit, so the cost has the curvature w X^T X - 2 w^2 / limit (X^T r) (X^T r)^T.
    """
    size = X.shape[2]
    gradients, curvatures = np.zeros((BLOCKS, size)), np.zeros((BLOCKS, size, size))
    present = np.unique(block).tolist()
    for each in present:
        members = block == each
        weight = weights[members]
        across = np.einsum("pij,pi->pj", X[members], left[members])
        rows = X[members].reshape(-1, size)
        gradients[each] = weight @ across
        curvatures[each] = (rows.T * np.repeat(weight, 2)) @ rows - (across.T * (2.0 * weight**2 / limit)) @ across
    gradient, curvature = gradients.sum(axis=0), curvatures.sum(axis=0) + 1e-9 * len(left) * np.eye(size)
    return np.array([np.linalg.solve(curvature - curvatures[b], gradient - gradients[b]) for b in present])
