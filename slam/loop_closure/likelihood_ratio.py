"""The log-likelihood ratio (LLR) of a loop-closure candidate: same place against clutter, object by object.

For object i of the query submap, placed at z_i by the pose of the candidate,

    LLR_i = log[ (1 - P_D) + P_D N(z_i; m_i, S_i) / lambda_i ],        LLR = sum_i LLR_i,

* m_i is the reference landmark that object i is matched with; without a match N(...) = 0, so LLR_i = log(1 - P_D);
* N is the density of the horizontal error [1/m^2], isotropic with S_i = (sigma_query^2 + sigma_reference^2) I;
* P_D (``DETECTION_PROBABILITY``) is the probability that an object of one traversal is in the map of another; of a
  landmark that is not confirmed it is multiplied by the probability that it exists;
* lambda_i is the clutter density: landmarks of the same class per m^2 near z_i, the matched one not counted.

The sum runs over the objects that should have a match: those with any reference landmark within ``COVERAGE_RANGES``.
All others contribute 0. This is the likelihood ratio of target and clutter in multi-target tracking (Bar-Shalom and Li,
Multitarget-Multisensor Tracking, 1995).

lambda_i is the largest of four densities: that within ``CLUTTER_RANGES``; that along the direction of travel, with a
Gaussian profile across it; that along the line to each of the two nearest landmarks of the class, which do not count
there themselves; and the prior of half an object in the area that was searched. Parked cars and trees stand in rows, so
a wrong pose on a parallel street matches most of a row; the density along it is high and the match is worth little.
"""

import numpy as np
from scipy.special import logsumexp

from slam.common.arrays import BoolArray, FloatArray, IntArray
from slam.common.geometry import apply, yaw_rad
from slam.object_map.submap import Submap

DETECTION_PROBABILITY = 0.85
"""P_D: probability that an object of one traversal is in the map of another."""
COVERAGE_RANGES = 1.0 / 3.0
"""A match is expected within that distance of any reference landmark, in sensor ranges."""
CLUTTER_RANGES = 1.0 / 6.0
"""Landmarks of the same class within that distance count as clutter, in sensor ranges, ..."""
ALONG_TRACK_RANGES, CROSS_TRACK_RANGES = 1.5, 0.7 / 30.0
"""... and those along the direction of travel within the first, with the second as standard deviation across it."""
PRIOR_OBJECTS, GRID = 10.0, 200
"""Weight, in objects, of the prior of P_D of a single place, and steps of the integral over it."""
LEAST_COUNT = 0.01
"""Least density of objects: so many in a square with sides of ``COVERAGE_RANGES`` sensor ranges."""


def compute_log_likelihood_ratios(
    query: Submap,
    reference: Submap,
    T_reference_query: FloatArray,
    pairs: IntArray,
    sensor_range_m: float,
    class_shares: FloatArray | None = None,
) -> FloatArray:
    """LLR_i (N,) [nats] of the objects of the query at ``T_reference_query`` (4, 4) with the inliers ``pairs`` (K, 2),
    rows of query and reference; zero where no match is expected.

    ``class_shares`` (C,), which sum to 1, are the frequencies of the classes in the whole map. With them the clutter
    density of a class that does not occur near the object is the lower, the rarer the class is.
    """
    placed = apply(T_reference_query, query.positions)
    offsets = reference.positions[:, None, :2] - placed[None, :, :2]  # (M, N, 2)
    distances = np.hypot(offsets[..., 0], offsets[..., 1])
    expected = np.any(distances < COVERAGE_RANGES * sensor_range_m, axis=0)
    matched_query, matched_reference = pairs.T
    is_other = np.ones(distances.shape, dtype=np.bool_)
    is_other[matched_reference, matched_query] = False
    alike = is_other & (reference.labels[:, None] == query.labels)
    shares = None if class_shares is None else class_shares[query.labels]
    densities = np.maximum(
        _row_densities(offsets, distances, alike, float(yaw_rad(T_reference_query)), sensor_range_m),
        _disc_densities(distances, is_other, alike, sensor_range_m, shares),
    )
    variances = query.sigmas[matched_query] ** 2 + reference.sigmas[matched_reference] ** 2
    squares = distances[matched_reference, matched_query] ** 2
    likelihoods = np.zeros(len(query))
    likelihoods[matched_query] = np.exp(-0.5 * squares / variances) / (2.0 * np.pi * variances)
    in_map = DETECTION_PROBABILITY * query.existence
    ratios = 1.0 - in_map + in_map * likelihoods / densities
    return np.where(expected, np.log(ratios), 0.0)


def changed_log_likelihood_ratio(per_object: FloatArray) -> float:
    """The LLR of objects (N,) in a place that may have changed since it was mapped [nats].

    It is the logarithm of the product of their likelihood ratios, integrated over the P_D that all of them share, with
    a beta prior of mean ``DETECTION_PROBABILITY`` and the weight of ``PRIOR_OBJECTS`` objects (beta-binomial).
    ``per_object`` are the LLR_i with that P_D; those that expect no match are zero.
    """
    ratios = np.maximum(np.expm1(per_object) / DETECTION_PROBABILITY, -1.0)  # N(...) / lambda_i - 1
    shares = (np.arange(GRID) + 0.5) / GRID
    a, b = PRIOR_OBJECTS * DETECTION_PROBABILITY, PRIOR_OBJECTS * (1.0 - DETECTION_PROBABILITY)
    log_prior = (a - 1.0) * np.log(shares) + (b - 1.0) * np.log1p(-shares)
    log_likelihoods = np.log1p(shares[:, None] * ratios).sum(axis=1)
    return float(logsumexp(log_prior + log_likelihoods) - logsumexp(log_prior))


def _disc_densities(
    distances: FloatArray, is_other: BoolArray, alike: BoolArray, sensor_range_m: float, shares: FloatArray | None
) -> FloatArray:
    """Landmarks (N,) of the same class per m^2 around each placed object, or those of the prior, if that is more.

    ``distances`` (M, N) m are from the objects to the landmarks; ``is_other`` (M, N): but the matched one; ``alike``
    (M, N): and of the same class; ``shares`` (N,) of the classes of the objects in the whole map.
    """
    clutter_m, coverage_m = CLUTTER_RANGES * sensor_range_m, COVERAGE_RANGES * sensor_range_m
    disc_area = np.pi * clutter_m**2
    in_disc = np.sum(alike & (distances < clutter_m), axis=0) / disc_area
    # Half an object as a pseudo-count: in the disc, or in as much of the map as holds half an object of the class.
    area = np.full(distances.shape[1], disc_area)
    if shares is not None:
        density = np.sum(is_other & (distances < coverage_m), axis=0) / (np.pi * coverage_m**2)
        area += 0.5 / (np.maximum(density, LEAST_COUNT / coverage_m**2) * shares)
    return np.maximum(in_disc, 0.5 / area)


def _row_densities(
    offsets: FloatArray, distances: FloatArray, others: BoolArray, heading_rad: float, sensor_range_m: float
) -> FloatArray:
    """Largest density (N,) of ``others`` (M, N) along the direction of travel, and along the line through each object
    and one of its two nearest, that one left out: a row need not run along the heading, as that before a corner.

    ``offsets`` (M, N, 2) m and ``distances`` (M, N) m are from the objects to the landmarks. Densities are Gaussian
    across the line.
    """
    along_m, sigma_m = ALONG_TRACK_RANGES * sensor_range_m, CROSS_TRACK_RANGES * sensor_range_m
    area = 2.0 * along_m * sigma_m * np.sqrt(2.0 * np.pi)
    count = distances.shape[1]
    columns, apart = np.arange(count), np.where(others, distances, np.inf)
    lines = [(np.tile([np.cos(heading_rad), np.sin(heading_rad)], (count, 1)), np.full(count, -1))]
    for _ in range(min(2, len(apart))):
        nearest = np.argmin(apart, axis=0)
        direction = offsets[nearest, columns] / np.maximum(distances[nearest, columns], 1e-9)[:, None]
        lines.append((np.where(np.isfinite(apart[nearest, columns])[:, None], direction, np.nan), nearest))
        apart[nearest, columns] = np.inf
    landmarks, objects = np.nonzero(others)
    x, y = offsets[landmarks, objects].T
    largest = np.zeros(count)
    for direction, left_out in lines:
        dx, dy = direction[objects].T
        inside = (landmarks != left_out[objects]) & (np.abs(x * dx + y * dy) < along_m)
        profile = np.exp(-0.5 * ((y * dx - x * dy)[inside] / sigma_m) ** 2)
        largest = np.maximum(largest, np.bincount(objects[inside], profile, count) / area)
    return largest
