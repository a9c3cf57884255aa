"""Places that a submap may be: by the descriptors of its objects, grouped by what pose they agree on.

Landmarks that the robot has left behind are settled: each gets the descriptor of its constellation, for the index.
Each object of a query is matched with its nearest descriptors; matches that agree on a pose are a place. So a few right
matches at one place outweigh many accidental ones that are scattered over the map.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from descriptors.constellation import gather_constellations
from descriptors.registry import make_index
from slam.common.arrays import FloatArray, IntArray
from slam.common.config import LoopClosureConfig, RegistrationConfig, SubmapConfig
from slam.common.errors import GeometryError
from slam.object_map.landmarks import LandmarkState, ObjectMap
from slam.object_map.submap import PASS_TRAVEL_M, Submap, placed_submap
from slam.registration.exhaustive_search import ExhaustiveSearch
from slam.registration.registration import register

logger = logging.getLogger(__name__)

# How far around a place landmarks are of use.
PLACE_RADIUS_M = 90.0
# So many objects of a query are looked for without descriptors, as the time grows with the square of their number.
SEARCHED_OBJECTS = 25
# Landmarks are entered into the index at most that often.
SETTLE_EVERY_M = 10.0


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """Where a query may be: ``T_odom_query`` (4, 4), as the pass around ``travel_m`` saw the odometry frame of a
    ``segment``.

    ``retrieval_distance``: mean distance of the agreeing matches in descriptor space; ``rank``: its place, from 1,
    among those that descriptors propose for a query, 0 where they did not.
    """

    T_odom_query: FloatArray
    travel_m: float
    segment: int
    retrieval_distance: float
    rank: int = 0


class PlaceFinder:
    """The index of settled landmarks."""

    def __init__(
        self,
        config: LoopClosureConfig,
        submap_config: SubmapConfig,
        registration_config: RegistrationConfig,
        object_map: ObjectMap,
    ) -> None:
        self._config = config
        self._submap_config = submap_config
        self._registration_config = registration_config
        self._map = object_map
        self._index = make_index(config.descriptor)
        self._rows = np.zeros(0, dtype=np.int64)  # landmark of each entry of the index
        self._settled_m = -np.inf
        self._searches: dict[int, tuple[IntArray, ExhaustiveSearch | None]] = {}

    def settle(self, travel_m: float) -> None:
        """Enter the landmarks that were left behind."""
        if travel_m - self._settled_m < SETTLE_EVERY_M:
            return
        self._settled_m = travel_m
        landmarks = self._map.rows
        confirmed = landmarks["state"] == LandmarkState.CONFIRMED
        behind = confirmed & (landmarks["last_seen_travel_m"] < travel_m - self._config.settle_travel_m)
        behind[self._rows] = False
        for segment in np.unique(landmarks["segment"][behind]):
            self._enter(np.flatnonzero(behind & (landmarks["segment"] == segment)), int(segment))

    def _enter(self, new: IntArray, segment: int) -> None:
        landmarks = self._map.rows
        earliest_m = landmarks["last_seen_travel_m"][new].min() - PASS_TRAVEL_M
        around = np.flatnonzero(
            (landmarks["state"] == LandmarkState.CONFIRMED)
            & (landmarks["segment"] == segment)
            & (landmarks["last_seen_travel_m"] > earliest_m)
        )
        constellations = gather_constellations(
            landmarks["position_odom"][around],
            self._map.classes(around),
            self._map.vocabulary,
            radius_m=self._index.radius_m,
            centres=np.asarray(np.searchsorted(around, new)),
        )
        self._index.add(constellations)
        self._rows = np.concatenate([self._rows, new])

    def class_shares(self) -> FloatArray:
        """How common each class is (C,) among the settled landmarks; each is taken to be there once more."""
        counts = 1.0 + np.bincount(self._map.classes(self._rows), minlength=len(self._map.vocabulary))
        return np.asarray(counts / counts.sum())

    def find(self, query: Submap, *, before_m: float, seed: int) -> list[Place]:
        """The likeliest places of a query, given in its gravity frame, among what was last seen before that travel."""
        landmarks = self._map.rows
        usable = (landmarks["last_seen_travel_m"] < before_m) & (landmarks["state"] == LandmarkState.CONFIRMED)
        constellations = gather_constellations(
            query.positions, query.labels, self._map.vocabulary, radius_m=self._index.radius_m
        )
        matches = self._index.search(constellations, self._config.neighbours, usable[self._rows])
        if not len(matches.queries):
            return []
        entries, references = np.unique(matches.entries, return_inverse=True)
        reference = placed_submap(self._map, self._rows[entries], np.zeros(3), self._submap_config)
        correspondences = np.column_stack([matches.queries, references])
        registrations = register(
            query.positions,
            reference.positions,
            correspondences,
            self._registration_config,
            query_sigmas=query.sigmas,
            reference_sigmas=np.full(len(reference), self._submap_config.landmark_sigma_m),
            rng=np.random.default_rng(seed),
            count=self._config.places,
        )
        places = [
            self._place(found.T_reference_query, reference.rows[found.pairs[:, 1]], matches.distances[found.inliers])
            for found in registrations
            if found.T_reference_query is not None
        ]
        return [replace(place, rank=rank) for rank, place in enumerate(places, start=1)]

    def find_anywhere(self, query: Submap, *, segment: int) -> list[Place]:
        """The likeliest places of a query among all of another ``segment``, by pairs of objects and no descriptor.

        Of a long query the objects nearest to the robot are enough. Where few objects or only common ones are in view,
        their descriptors say less than their places do; it takes longer, but to one who is lost that is well spent.
        """
        rows, search = self._search_of(segment) if self._config.lost_places else (self._rows, None)
        if search is None:
            return []
        nearest = np.argsort(np.hypot(query.positions[:, 0], query.positions[:, 1]), kind="stable")
        some = query.of(nearest[:SEARCHED_OBJECTS])
        found = search.leading(some.positions, some.labels, query_sigmas=some.sigmas)
        return [
            self._place(each.T_reference_query, rows[each.pairs[:, 1]], np.full(1, np.inf, np.float32))
            for each in found[: self._config.lost_places]
            if each.T_reference_query is not None
        ]

    def _search_of(self, segment: int) -> tuple[IntArray, ExhaustiveSearch | None]:
        """The landmarks (M,) of a segment that are settled, and the search among them."""
        landmarks = self._map.rows
        rows = self._rows[(landmarks["segment"][self._rows] == segment)]
        rows = rows[landmarks["state"][rows] == LandmarkState.CONFIRMED]
        known = self._searches.get(segment)
        if known is None or not np.array_equal(known[0], rows):
            self._searches[segment] = known = rows, self._make_search(rows) if len(rows) else None
        return known

    def _make_search(self, rows: IntArray) -> ExhaustiveSearch | None:
        reference = placed_submap(self._map, rows, np.zeros(3), self._submap_config)
        sigmas = np.full(len(rows), self._submap_config.landmark_sigma_m)
        try:
            return ExhaustiveSearch(reference.positions, reference.labels, self._registration_config, map_sigmas=sigmas)
        except GeometryError as error:
            logger.warning("places are found by descriptors alone: %s", error)
            return None

    def _place(self, T_odom_query: FloatArray, rows: IntArray, distances: NDArray[np.float32]) -> Place:
        """The place of a pose on which matches with the landmarks ``rows`` (K,) agree."""
        landmarks = self._map.rows[rows]
        segments, counts = np.unique(landmarks["segment"], return_counts=True)
        segment = int(segments[np.argmax(counts)])
        travels_m = landmarks["last_seen_travel_m"][landmarks["segment"] == segment]
        return Place(T_odom_query, float(np.median(travels_m)), segment, float(distances.mean()))

    def surroundings(self, place: Place, *, before_m: float) -> Submap:
        """The landmarks around a place as its pass saw them, in the odometry frame."""
        landmarks = self._map.rows
        centre = place.T_odom_query[:3, 3]
        offsets = landmarks["position_odom"][:, :2] - centre[:2]
        rows = np.flatnonzero(
            (np.abs(landmarks["last_seen_travel_m"] - place.travel_m) < PASS_TRAVEL_M)
            & (landmarks["last_seen_travel_m"] < before_m)
            & (landmarks["segment"] == place.segment)
            & (landmarks["state"] == LandmarkState.CONFIRMED)
            & (np.einsum("ij,ij->i", offsets, offsets) < PLACE_RADIUS_M**2)
        )
        return placed_submap(self._map, rows, centre, self._submap_config)
