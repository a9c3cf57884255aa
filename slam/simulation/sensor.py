"""An object detector with missed and false detections, and errors of position and class."""

from collections.abc import Mapping

import numpy as np

from logs.records import frozen
from slam.common.arrays import BoolArray, FloatArray, IntArray
from slam.simulation.config import SensorConfig


@frozen
class Scan:
    """Detections of one scan, in the order of their bearing.

    positions (N, 3) m, body frame; class_indices (N,) into the vocabulary; scores (N,); sigmas_m (N,): standard
    deviation of the position noise, the same on each axis; sources (N,): row of the true object, -1: false positive.
    """

    positions: FloatArray
    class_indices: IntArray
    scores: FloatArray
    sigmas_m: FloatArray
    sources: IntArray


def bearings_rad(positions: FloatArray) -> FloatArray:
    """Bearings (N,) of positions (N, 2 or more), metres, body frame; 0 is ahead, positive to the left."""
    return np.arctan2(positions[:, 1], positions[:, 0])


def in_view(positions: FloatArray, config: SensorConfig) -> BoolArray:
    """Which of the positions (N, 3), metres, body frame, are within range and within the field of view: (N,)."""
    near = np.linalg.norm(positions, axis=1) <= config.max_range_m
    return near & (np.abs(bearings_rad(positions)) <= 0.5 * np.deg2rad(config.field_of_view_deg))


def unshadowed(positions: FloatArray, radius_m: float) -> BoolArray:
    """Which of the positions (N, 3), metres, body frame, no other one hides: (N,).

    Seen from above, an object of radius r at distance d hides the bearings within arcsin(r / d) of its own, from r
    behind its centre on, so that a sign on a lamp post stays visible. What the sensor itself stands in hides nothing.
    """
    distance_m = np.hypot(positions[:, 0], positions[:, 1])
    bearing = bearings_rad(positions)
    outside = distance_m > radius_m
    half_angle = np.arcsin(np.divide(radius_m, distance_m, out=np.zeros_like(distance_m), where=outside))
    # [i, j]: whether i hides j; in place, since this is most of the time of a simulation.
    apart = bearing[None, :] - bearing[:, None]
    np.abs(apart, out=apart)
    np.minimum(apart, 2.0 * np.pi - apart, out=apart)
    hides = apart < half_angle[:, None]
    hides &= distance_m[None, :] > distance_m[:, None] + radius_m
    return np.asarray(~hides.any(axis=0))


def scan_objects(
    positions: FloatArray,
    class_indices: IntArray,
    class_count: int,
    config: SensorConfig,
    rngs: Mapping[str, np.random.Generator],
) -> Scan:
    """Detect the objects at ``positions`` (N, 3), metres, body frame, whose classes are ``class_indices`` (N,).

    An object is seen if it is in view, unshadowed (by those in view) and not dropped. Its
    position gets N(0, sigma^2) on each axis, sigma = ``noise_base_m`` + ``noise_per_m`` times the true range. With the
    probability ``misclassification`` times range / ``max_range_m`` its label is one of the other classes, all alike.
    ``rngs`` has a generator for each cause of error, so that switching one off leaves the others' numbers as they are.
    The number of false positives is Poisson; they lie evenly over the area in view at z = 0 plus noise, with any class.
    """
    rows = np.flatnonzero(in_view(positions, config))
    seen = positions[rows]
    # Numbers are drawn for everything in view, so that neither shadows nor dropout shift another object's numbers.
    normals = rngs["position"].standard_normal((len(rows), 3))
    kept = rngs["dropout"].random(len(rows)) >= config.dropout
    label_draw, other_draw = rngs["label"].random((2, len(rows)))
    score_normals = rngs["score"].standard_normal(len(rows))
    if config.occlusion:
        kept &= unshadowed(seen, config.occluder_radius_m)

    range_m = np.linalg.norm(seen, axis=1)
    sigmas_m = config.noise_base_m + config.noise_per_m * range_m
    measured = seen + sigmas_m[:, None] * normals
    wrong = label_draw < config.misclassification * range_m / config.max_range_m
    classes = class_indices[rows]
    if class_count > 1:
        shift = 1 + np.minimum((other_draw * (class_count - 1)).astype(np.int64), class_count - 2)
        classes = np.where(wrong, (classes + shift) % class_count, classes)
    scores = 0.9 - 0.25 * range_m / config.max_range_m - 0.2 * wrong + 0.05 * score_normals

    detected = (measured, classes, scores, sigmas_m, rows)
    invented = _false_positives(class_count, config, rngs["false_positive"])
    columns = [np.concatenate([each[kept], false]) for each, false in zip(detected, invented, strict=True)]
    order = np.argsort(bearings_rad(columns[0]), kind="stable")
    positions, classes, scores, sigmas_m, sources = (column[order] for column in columns)
    return Scan(positions, classes, scores.clip(0.05, 1.0), sigmas_m, sources)


def _false_positives(
    class_count: int, config: SensorConfig, rng: np.random.Generator
) -> tuple[FloatArray, IntArray, FloatArray, FloatArray, IntArray]:
    """The fields of a :class:`Scan` of nothing."""
    count = rng.poisson(config.false_positives_per_scan)
    range_m = config.max_range_m * np.sqrt(rng.random(count))
    bearing = (rng.random(count) - 0.5) * np.deg2rad(config.field_of_view_deg)
    sigmas_m = config.noise_base_m + config.noise_per_m * range_m
    positions = np.stack(
        [range_m * np.cos(bearing), range_m * np.sin(bearing), sigmas_m * rng.standard_normal(count)], axis=1
    )
    classes = rng.integers(class_count, size=count)
    scores = rng.normal(0.45, 0.15, count)
    return positions, classes, scores, sigmas_m, np.full(count, -1, dtype=np.int64)
