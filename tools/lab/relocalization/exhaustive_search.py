"""A query of a few objects in a map without any descriptor: every pair against every pair of the same classes.

What a descriptor must be better than, or faster. It is for maps of some thousand objects.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from slam.common.arrays import FloatArray, IntArray
from slam.registration.estimate import Registration, not_found
from slam.registration.parameters import RegistrationConfig
from slam.registration.pose_voting import Matches, vote_for_poses
from slam.registration.registration import refine_many

VOTED = 64
"""Poses with most votes that are refined."""
MAX_MATCHES = 5_000_000
"""Pairs of pairs that vote: what a gigabyte holds. The pairs of the query with the fewest counterparts come first."""


@dataclass(frozen=True, slots=True, eq=False)
class ExhaustiveSearch:
    """All pairs of a map up to ``reach_m`` long, sorted by classes and length.

    ``positions`` (M, 3) m, z up; ``labels`` (M,); ``sigmas`` (M,) m, noise of a position along any axis.
    """

    positions: FloatArray
    labels: IntArray
    sigmas: FloatArray
    config: RegistrationConfig
    reach_m: float
    first: IntArray
    second: IntArray
    keys: FloatArray

    def localize(self, positions: FloatArray, labels: IntArray, *, sigmas: FloatArray) -> list[Registration]:
        """The distinct poses of a query in the map with the best scores, best first; or one answer "no".

        Args:
            positions: (N, 3) m, z up.
            labels: (N,), numbered as those of the map.
            sigmas: (N,) m, noise of a position along any axis.
        """
        matches = self._matches(positions, labels, sigmas)
        if not len(matches):
            return [not_found("no pair of the objects is as long as a pair of the map with the same labels")]
        poses = vote_for_poses(positions, self.positions, matches, tolerance_m=2.0 * self._sigma_m(sigmas), count=VOTED)
        answers = refine_many(
            positions,
            labels,
            self.positions,
            self.labels,
            poses,
            self.config,
            query_sigmas=sigmas,
            reference_sigmas=self.sigmas,
        )
        return sorted(answers, key=lambda answer: -answer.score)

    def _matches(self, positions: FloatArray, labels: IntArray, sigmas: FloatArray) -> Matches:
        """Pairs of the query with the pairs of the map whose classes and lengths they have."""
        i, j = np.triu_indices(len(positions), 1)
        lengths = np.hypot(*(positions[j] - positions[i])[:, :2].T)
        tolerance = self.config.gate_sigma * np.sqrt(2.0) * self._sigma_m(sigmas)
        if self.config.estimate_scale:
            tolerance = np.hypot(tolerance, self.config.gate_sigma * self.config.scale_sigma * lengths)
        key = _key(labels[i], labels[j], 2.0 * self.reach_m)
        shortest = np.maximum(lengths - tolerance, self.config.min_baseline_m)
        start = np.searchsorted(self.keys, key + np.minimum(shortest, 1.5 * self.reach_m))
        end = np.searchsorted(self.keys, key + np.minimum(lengths + tolerance, 1.5 * self.reach_m), side="right")
        counts = np.maximum(end - start, 0)
        order = np.argsort(counts, kind="stable")
        chosen = order[: np.searchsorted(np.cumsum(counts[order]), MAX_MATCHES, side="right")]
        pair = np.repeat(chosen, counts[chosen])
        before = np.repeat(np.cumsum(counts[chosen]) - counts[chosen], counts[chosen])
        entry = start[pair] + np.arange(len(pair)) - before
        return Matches(np.column_stack([i[pair], j[pair]]), np.column_stack([self.first[entry], self.second[entry]]))

    def _sigma_m(self, sigmas: FloatArray) -> float:
        return float(np.hypot(np.median(sigmas), np.median(self.sigmas)))


def make_exhaustive_search(
    positions: FloatArray, labels: IntArray, sigmas: FloatArray, config: RegistrationConfig, *, reach_m: float
) -> ExhaustiveSearch:
    """The search in a map; see :class:`ExhaustiveSearch`."""
    pairs = cKDTree(positions[:, :2]).query_pairs(reach_m, output_type="ndarray").astype(np.int64)
    first, second = np.concatenate([pairs, pairs[:, ::-1]]).T
    lengths = np.hypot(*(positions[second] - positions[first])[:, :2].T)
    keys = _key(labels[first], labels[second], 2.0 * reach_m) + lengths
    order = np.argsort(keys, kind="stable")
    return ExhaustiveSearch(positions, labels, sigmas, config, reach_m, first[order], second[order], keys[order])


def _key(first: IntArray, second: IntArray, stride: float) -> FloatArray:
    """Where pairs (P,) of two classes begin; lengths up to the ``stride`` are added."""
    return np.asarray((first * 2**20 + second) * stride)
