"""Where in a map of objects a sensor is, from what it sees and nothing else (Descriptellation, Section III-D)."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from descriptors.constellation import gather_constellations
from descriptors.index import ConstellationIndex, Matches
from slam.common.arrays import FloatArray, IntArray
from slam.common.config import RegistrationConfig
from slam.registration.registration import Registration, refine_many, register

NEIGHBOURS = 100
"""Candidates of each object; the registration takes about a millisecond for a hundred correspondences."""
POSES = 5
"""Poses that are compared on all objects around them and not on the candidates alone."""
SURROUNDINGS_FACTOR = 5.0
"""How far beyond the farthest object of the query the map is looked at, in multiples of ``search_radius_m``."""


@dataclass(frozen=True, slots=True, eq=False)
class LabelledMap:
    """Objects (M, 3) m with labels (M,) in ``vocabulary``."""

    positions: FloatArray
    labels: IntArray
    vocabulary: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.labels)


@dataclass(frozen=True, slots=True, eq=False)
class Localization:
    """The registration of a query in the map, the matches that it came from, and the time for either, in seconds."""

    registration: Registration
    matches: Matches
    match_s: float
    verify_s: float


class GlobalLocalizer:
    """A map with an index of its constellations."""

    def __init__(self, objects: LabelledMap, index: ConstellationIndex, *, neighbours: int = NEIGHBOURS) -> None:
        """Describe all objects of the map into the empty ``index``."""
        self._objects = objects
        self._index = index
        self._neighbours = neighbours
        self._tree = cKDTree(objects.positions[:, :2])
        self._everywhere = np.ones(len(objects), dtype=bool)
        index.add(gather_constellations(objects.positions, objects.labels, objects.vocabulary, radius_m=index.radius_m))

    def localize(
        self,
        positions: FloatArray,
        labels: IntArray,
        config: RegistrationConfig,
        *,
        query_sigmas: FloatArray,
        map_sigma_m: float,
        seed: int = 0,
    ) -> Localization:
        """The pose of a query.

        Args:
            positions: (N, 3) m in the query's gravity frame.
            labels: (N,) in the vocabulary of the map.
            config: of the registration.
            query_sigmas: (N,) m, noise of a position along any axis.
            map_sigma_m: the same of the map's objects.
            seed: of the registration's draws, where there are too many pairs to try all.
        """
        started = time.perf_counter()
        # 1. The constellation of each object that is seen, and 2. its likeliest counterparts in the map.
        constellations = gather_constellations(
            positions, labels, self._objects.vocabulary, radius_m=self._index.radius_m
        )
        matches = self._index.search(constellations, self._neighbours, self._everywhere)
        matched = time.perf_counter()
        # 3. Poses on which many of these agree, and 4. of those the one at which most of the map agrees.
        found = register(
            positions,
            self._objects.positions,
            np.column_stack([matches.queries, matches.entries]),
            config,
            query_sigmas=query_sigmas,
            reference_sigmas=np.full(len(self._objects), map_sigma_m),
            rng=np.random.default_rng(seed),
            count=POSES,
        )
        best = self._best(found, positions, labels, config, query_sigmas, map_sigma_m)
        return Localization(best, matches, matched - started, time.perf_counter() - matched)

    def _best(
        self,
        found: list[Registration],
        positions: FloatArray,
        labels: IntArray,
        config: RegistrationConfig,
        query_sigmas: FloatArray,
        map_sigma_m: float,
    ) -> Registration:
        poses = [answer.T_reference_query for answer in found if answer.T_reference_query is not None]
        if not poses:
            return found[0]
        T_map_query = np.stack(poses)
        farthest_m = float(np.linalg.norm(positions[:, :2], axis=1).max())
        near = self._around(T_map_query, farthest_m + SURROUNDINGS_FACTOR * config.search_radius_m)
        refined = refine_many(
            positions,
            labels,
            self._objects.positions[near],
            self._objects.labels[near],
            T_map_query,
            config,
            query_sigmas=query_sigmas,
            reference_sigmas=np.full(len(near), map_sigma_m),
        )
        best = max(refined, key=lambda answer: answer.score)
        if not best.found:
            return found[0]
        pairs = np.column_stack([best.pairs[:, 0], near[best.pairs[:, 1]]])
        return replace(best, pairs=pairs)

    def _around(self, T_map_query: FloatArray, radius_m: float) -> NDArray[np.int64]:
        """Objects of the map that one of the poses (H, 4, 4) could see."""
        found = self._tree.query_ball_point(T_map_query[:, :2, 3], radius_m)
        return np.unique(np.concatenate([np.asarray(near, dtype=np.int64) for near in found]))
