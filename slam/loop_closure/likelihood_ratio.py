"""How much speaks for a placement of one submap in another: a likelihood ratio, object by object.

Either the query is where it is placed, and then an object of it is seen again with the probability of persisting, at a
distance that the noise explains; or it is elsewhere, and then an object of its class is there by accident, as often as
such objects stand around. The ratio of the two, in nats, is what an object says; the sum over all objects that should
be seen is the evidence (the log Bayes factor of place against accident).

How often objects stand around is counted near the place itself, and along the direction of travel more than across it:
parked cars and trees stand in rows, so that a wrong place on a similar street repeats most of a row by accident.
Without this, rows alone would close loops between parallel streets.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam.common.arrays import FloatArray, IntArray
from slam.common.config import EvidenceConfig
from slam.common.geometry import apply, yaw_rad
from slam.object_map.submap import Submap

LEAST_DENSITY = 1e-4
"""Objects of a class per m^2, however rare it is: one on a hectare."""


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """``nats`` (N,): what each object of the query says; zero where none should be seen. ``expected`` (N,): where one
    should. ``matched_count``: how many are seen again.
    """

    nats: FloatArray
    expected: FloatArray
    matched_count: int

    @property
    def total(self) -> float:
        """The evidence, in nats."""
        return float(self.nats.sum())

    @property
    def matched_fraction(self) -> float:
        """Share of the objects that should be seen again that are."""
        return self.matched_count / max(int(self.expected.sum()), 1)


def weigh(
    query: Submap,
    reference: Submap,
    T_reference_query: FloatArray,
    pairs: IntArray,
    config: EvidenceConfig,
    class_shares: FloatArray | None = None,
) -> Evidence:
    """Evidence for ``T_reference_query`` (4, 4), under which the objects ``pairs`` (K, 2) of both submaps meet.

    ``class_shares`` (C,), which sum to 1, say how common each class is in a whole map: an object that is alone of its
    class in its neighbourhood says the more, the rarer that class is.
    """
    placed = apply(T_reference_query, query.positions)
    offsets = reference.positions[:, None, :2] - placed[None, :, :2]  # (M, N, 2)
    distances = np.hypot(offsets[..., 0], offsets[..., 1])
    expected = np.any(distances < config.covered_m, axis=0)
    densities = _accident_densities(
        query, reference, offsets, distances, float(yaw_rad(T_reference_query)), pairs, config, class_shares
    )
    seen_query, seen_reference = pairs[:, 0], pairs[:, 1]
    variances = query.sigmas[seen_query] ** 2 + reference.sigmas[seen_reference] ** 2
    squares = distances[seen_reference, seen_query] ** 2
    again = np.zeros(len(query))
    again[seen_query] = np.exp(-0.5 * squares / variances) / (2.0 * np.pi * variances)
    ratios = 1.0 - config.persistence + config.persistence * again / densities
    return Evidence(np.where(expected, np.log(ratios), 0.0), expected, len(pairs))


def _accident_densities(
    query: Submap,
    reference: Submap,
    offsets: FloatArray,
    distances: FloatArray,
    heading_rad: float,
    pairs: IntArray,
    config: EvidenceConfig,
    class_shares: FloatArray | None,
) -> FloatArray:
    """Objects (N,) of the same class per m^2 around each placed object of the query, the one it meets left out."""
    others = reference.labels[:, None] == query.labels[None, :]
    others[pairs[:, 1], pairs[:, 0]] = False
    around_area = np.pi * config.around_m**2
    around = np.sum(others & (distances < config.around_m), axis=0) / around_area
    c, s = np.cos(heading_rad), np.sin(heading_rad)
    along = c * offsets[..., 0] + s * offsets[..., 1]
    across = c * offsets[..., 1] - s * offsets[..., 0]
    row_area = 2.0 * config.row_length_m * config.row_sigma_m * np.sqrt(2.0 * np.pi)
    in_row = others & (np.abs(along) < config.row_length_m)
    rows = np.sum(in_row * np.exp(-0.5 * (across / config.row_sigma_m) ** 2), axis=0) / row_area
    # Where none stands around, half a one might: in the circle, or in as much of the map as holds half a one.
    area = np.full(len(query), around_area)
    if class_shares is not None:
        density = np.sum(distances < config.covered_m, axis=0) / (np.pi * config.covered_m**2)
        area += 0.5 / np.maximum(density * class_shares[query.labels], LEAST_DENSITY)
    return np.asarray(np.maximum(np.maximum(around, rows), 0.5 / area))
