"""What a robot sees of a map on a short stretch: part of it, not exactly, and some things that are not there."""

import numpy as np

from descriptors.arrays import FloatArray, IntArray, frozen
from descriptors.training.maps import TrainingMap

CLUTTER = -1
"""What is seen and is no object of the map."""


@frozen
class View:
    """N objects at ``positions`` (N, 3) m with ``labels`` (N,); ``objects`` (N,): which of the map, or ``CLUTTER``;
    ``sigma_m``: noise of a coordinate, as the sensor knows it.
    """

    positions: FloatArray
    labels: IntArray
    objects: IntArray
    sigma_m: float


def draw_view(seen_map: TrainingMap, *, rng: np.random.Generator, sigma_m: float | None = None) -> View:
    """A view from a stretch of 0 to 40 m beside an object that is drawn; ``sigma_m``: noise of a coordinate, drawn if
    None.

    What is drawn: range and field of view; how likely an object is seen, which falls with its range; the noise of the
    positions, the same everywhere or growing with the range, to one side, or a scale; confused classes; clutter.
    """
    path, headings = _draw_path(seen_map, rng=rng)
    range_m, bearing_rad = rng.uniform(12.0, 30.0), np.deg2rad(rng.choice([45.0, 90.0, 180.0, 180.0, 180.0]))
    offsets = seen_map.positions[:, None, :2] - path
    ranges_m = np.linalg.norm(offsets, axis=2)
    bearings = np.arctan2(offsets[:, :, 1], offsets[:, :, 0]) - headings
    in_view = (ranges_m < range_m) & (np.abs(np.angle(np.exp(1j * bearings))) <= bearing_rad)
    nearest = np.where(in_view, ranges_m, np.inf).argmin(axis=1)
    nearest_m = ranges_m[np.arange(len(seen_map)), nearest]
    missed = rng.uniform(0.0, 0.5) + rng.uniform(0.0, 0.3) * (nearest_m / range_m) ** 2
    seen = np.flatnonzero(in_view.any(axis=1) & (rng.random(len(seen_map)) >= missed))
    eye = path[nearest[seen]]
    positions = seen_map.positions[seen]
    if sigma_m is None:
        sigma_m = float(np.exp(rng.uniform(np.log(0.03), np.log(0.7))))
    positions[:, :2] = eye + _measured(positions[:, :2] - eye, sigma_m, rng=rng)
    positions[:, 2] += rng.normal(0.0, 0.2, len(seen))
    wrong = rng.random(len(seen)) < rng.uniform(0.0, 0.2)
    labels = np.where(wrong, rng.integers(seen_map.classes, size=len(seen)), seen_map.labels[seen])
    clutter = rng.poisson(rng.uniform(0.0, 0.3) * len(seen))  # none where nothing is seen
    middle = path[rng.integers(len(path), size=clutter)]
    at = middle + range_m * np.sqrt(rng.random(clutter))[:, None] * _directions(rng.uniform(-np.pi, np.pi, clutter))
    like = rng.integers(max(len(seen), 1), size=clutter)
    return View(
        np.vstack([positions, np.column_stack([at, positions[like, 2]])]),
        np.concatenate([labels, labels[like]]),
        np.concatenate([seen, np.full(clutter, CLUTTER)]),
        sigma_m,
    )


def _draw_path(seen_map: TrainingMap, *, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Places (K, 2) m and headings (K,) of a stretch."""
    start = seen_map.positions[rng.integers(len(seen_map)), :2] + rng.normal(0.0, 4.0, 2)
    length_m = rng.uniform(0.0, 40.0) if rng.random() < 0.7 else 0.0
    steps_m = np.arange(0.0, length_m + 1e-9, 5.0)
    headings = rng.uniform(-np.pi, np.pi) + rng.normal(0.0, 0.01) * steps_m
    return start + steps_m[:, None] * _directions(headings), headings


def _measured(offsets: FloatArray, sigma_m: float, *, rng: np.random.Generator) -> FloatArray:
    """Offsets (N, 2) m from the sensor, as it measures them."""
    ranges_m = np.linalg.norm(offsets, axis=1, keepdims=True)
    noisy = offsets + rng.normal(0.0, sigma_m, offsets.shape)
    if rng.random() < 0.3:
        noisy = noisy + ranges_m * (rng.normal(0.0, 0.03, offsets.shape) + rng.normal(0.0, 0.03, 2))
        noisy = noisy * rng.uniform(0.9, 1.1)
    return noisy


def _directions(angles: FloatArray) -> FloatArray:
    return np.column_stack([np.cos(angles), np.sin(angles)])
