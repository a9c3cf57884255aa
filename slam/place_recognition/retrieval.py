"""Retrieval: candidate places of a query submap, by nearest-neighbour search over descriptors of its objects.

Inactive landmarks, which the robot has left behind, are indexed by the descriptor of their constellation. Each object
of a query is matched with its ``top_k`` nearest neighbours in descriptor space; matches that agree on a pose form a
place. So a few true matches at one place outweigh many false ones that are scattered over the map.
"""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from descriptors.constellation import Constellations, gather_constellations
from descriptors.registry import make_index
from slam.common.arrays import BoolArray, FloatArray, IntArray
from slam.common.config import Config
from slam.common.errors import GeometryError
from slam.object_map.landmarks import LandmarkState, ObjectMap
from slam.object_map.submap import TRAVERSAL_EXTENT, Submap, placed_submap
from slam.place_recognition.imported_places import SEGMENT, ImportedPlaces
from slam.place_recognition.place import Place, traversal_of
from slam.place_recognition.triangle_retrieval import TriangleRetriever
from slam.registration.exhaustive_search import ExhaustiveSearch
from slam.registration.parameters import registration_config
from slam.registration.registration import register

logger = logging.getLogger(__name__)

INACTIVE_RANGES = 2.0
"""A landmark unseen for that travel, in sensor ranges, is added to the index: the robot has left it behind."""
# Radius of a reference submap, in sensor ranges.
PLACE_RADIUS_RANGES = 90.0 / 30.0
# Sensor range for which the descriptors are made: their rings, kernels and radii are lengths of their own.
DESCRIPTOR_RANGE_M = 30.0
# Longest pair of objects of a query in the exhaustive search, in sensor ranges: the diameter of what a sensor sees.
SEARCHED_PAIR_RANGES = 2.0
# Objects of a query in the exhaustive search, whose time grows with the square of their number.
SEARCHED_OBJECTS = 25
# Descriptors are compared where a class tells at least one bit: rings full of objects of one class are all alike.
DESCRIBED_PERPLEXITY = 2.0
INDEXED_TRAVERSALS = 4
"""So many traversals of a place are in the index; what more there are would be found no sooner."""
# Least travel between two updates of the index, in sensor ranges.
INDEX_EVERY_RANGES = 10.0 / 30.0


class PlaceRetriever:
    """Retrieves places from an index of inactive landmarks, and from the imported map where one is given."""

    def __init__(self, config: Config, object_map: ObjectMap, imported: ImportedPlaces | None = None) -> None:
        self._imported = imported
        self._config = config.loop_closure
        self._calibration = config.calibration
        self._registration_config = registration_config(config)
        self._sensor_range_m = config.sensor_range_m
        self._extent_m = TRAVERSAL_EXTENT * config.closure_travel_m
        self._map = object_map
        self._index = make_index(config.loop_closure.descriptor)
        self._triangles = TriangleRetriever(
            object_map, landmark_sigma_m=config.calibration.objects.landmark_sigma_m, extent_m=self._extent_m
        )
        self._rows = np.zeros(0, dtype=np.int64)  # landmark of each entry of the index
        self._left_out = np.zeros(0, dtype=np.int64)
        self._indexed_m = -np.inf
        self._searches: dict[int, tuple[IntArray, ExhaustiveSearch | None]] = {}

    def index_inactive_landmarks(self, travel_m: float) -> None:
        """Add the landmarks unseen for ``inactive_travel_m`` to the index."""
        if travel_m - self._indexed_m < INDEX_EVERY_RANGES * self._sensor_range_m:
            return
        self._indexed_m = travel_m
        landmarks = self._map.rows
        confirmed = landmarks["state"] == LandmarkState.CONFIRMED
        behind = confirmed & (landmarks["last_seen_travel_m"] < travel_m - INACTIVE_RANGES * self._sensor_range_m)
        behind[self._rows] = behind[self._left_out] = False
        if self._imported is not None:
            behind &= landmarks["segment"] != SEGMENT
        for segment in np.unique(landmarks["segment"][behind]):
            new = np.flatnonzero(behind & (landmarks["segment"] == segment))
            often = self._seen_often(new)
            self._left_out = np.concatenate([self._left_out, new[often]])
            if not often.all():
                self._enter(new[~often], int(segment))

    def _seen_often(self, new: IntArray) -> BoolArray:
        """Which landmarks (N,) are indexed as ``INDEXED_TRAVERSALS`` of earlier traversals."""
        indexed = np.zeros(len(self._map), dtype=np.bool_)
        indexed[self._rows] = True
        kept = [self._map.canonical_id(row) for row in new.tolist()]
        counts = [np.count_nonzero(indexed[[row, *self._map.absorbed(row)]]) for row in kept]
        return np.array(counts, dtype=np.int64) >= INDEXED_TRAVERSALS

    def _enter(self, new: IntArray, segment: int) -> None:
        landmarks = self._map.rows
        earliest_m = landmarks["last_seen_travel_m"][new].min() - self._extent_m
        around = np.flatnonzero(
            (landmarks["state"] == LandmarkState.CONFIRMED)
            & (landmarks["segment"] == segment)
            & (landmarks["last_seen_travel_m"] > earliest_m)
        )
        centres = np.asarray(np.searchsorted(around, new))
        self._triangles.add(around, centres)
        self._index.add(self._constellations(landmarks["position_local"][around], self._map.classes(around), centres))
        self._rows = np.concatenate([self._rows, new])

    def _constellations(
        self, positions: FloatArray, labels: IntArray, centres: IntArray | None = None
    ) -> Constellations:
        """Constellations of objects (N, 3) m, scaled to a sensor that sees as far as the descriptors are made for."""
        scaled = positions * (DESCRIPTOR_RANGE_M / self._sensor_range_m)
        return gather_constellations(
            scaled, labels, self._map.vocabulary, radius_m=self._index.radius_m, centres=centres
        )

    def class_shares(self) -> FloatArray:
        """Frequency (C,) of each class among the indexed landmarks or in the imported map, with a pseudo-count of 1."""
        if self._imported is not None:
            return self._imported.class_shares()
        counts = 1.0 + np.bincount(self._map.classes(self._rows), minlength=len(self._map.vocabulary))
        return np.asarray(counts / counts.sum())

    def class_perplexity(self) -> float:
        """The number of equally frequent classes that would be as hard to guess as those of the indexed landmarks."""
        counts = np.bincount(self._map.classes(self._rows))
        shares = counts[counts > 0] / max(len(self._rows), 1)
        return float(np.exp(-np.sum(shares * np.log(shares))))

    def retrieve(self, query: Submap, *, before_m: float, seed: int) -> list[Place]:
        """The best places of a query, given in its gravity frame, among landmarks seen before that travel.

        By triangles first, and by descriptors where classes are distinctive.
        """
        landmarks = self._map.rows
        usable = (landmarks["first_seen_travel_m"] < before_m) & (landmarks["state"] == LandmarkState.CONFIRMED)
        by_triangles = self._config.max_candidates_by_triangles
        places = self._triangles.retrieve(query, usable, count=by_triangles) if by_triangles else []
        if not by_triangles or self.class_perplexity() >= DESCRIBED_PERPLEXITY:
            places += self._described(query, usable, seed=seed)
        return [replace(place, rank=rank) for rank, place in enumerate(places, start=1)]

    def _described(self, query: Submap, usable: BoolArray, *, seed: int) -> list[Place]:
        """The best places of a query by descriptors."""
        constellations = self._constellations(query.positions, query.labels)
        matches = self._index.search(constellations, self._config.top_k, usable[self._rows])
        if not len(matches.queries):
            return []
        entries, references = np.unique(matches.entries, return_inverse=True)
        reference = placed_submap(self._map, self._rows[entries], np.zeros(3), self._calibration)
        correspondences = np.column_stack([matches.queries, references])
        registrations = register(
            query.positions,
            reference.positions,
            correspondences,
            self._registration_config,
            query_sigmas=query.sigmas,
            reference_sigmas=np.full(len(reference), self._calibration.objects.landmark_sigma_m),
            rng=np.random.default_rng(seed),
            count=self._config.max_candidates,
        )
        return [
            self._place(found.T_reference_query, reference.rows[found.pairs[:, 1]], matches.distances[found.inliers])
            for found in registrations
            if found.T_reference_query is not None
        ]

    def aliases(self, query: Submap) -> FloatArray:
        """Poses (H, 4, 4) of a query in itself at which its objects repeat; one of them is the identity.

        As many as there are candidates of a query in the map.
        """
        count = self._config.max_candidates + self._config.max_candidates_by_triangles
        return self._triangles.aliases(query, count=count)

    @property
    def has_imported_map(self) -> bool:
        """Whether there is a map that nobody drove."""
        return self._imported is not None

    def search_imported_map(self, query: Submap) -> list[Place]:
        """The best places of a query in the imported map; none without one."""
        if self._imported is None:
            return []
        found = self._imported.retrieve(query, count=self._config.max_candidates_when_lost)
        return [replace(place, rank=rank) for rank, place in enumerate(found, start=1)]

    def search_exhaustively(self, query: Submap, *, segment: int) -> list[Place]:
        """The best places of a query among all landmarks of another ``segment``, by pairs of objects, no descriptors.

        The search finds places with few or only common objects, which descriptors do not distinguish. It takes longer,
        so it only runs while the robot is lost, and only for the ``SEARCHED_OBJECTS`` nearest objects of the query.
        """
        rows, search = self._search_of(segment) if self._config.max_candidates_when_lost else (self._rows, None)
        if search is None:
            return []
        nearest = np.argsort(np.hypot(query.positions[:, 0], query.positions[:, 1]), kind="stable")
        some = query.of(nearest[:SEARCHED_OBJECTS])
        found = search.leading(some.positions, some.labels, query_sigmas=some.sigmas)
        return [
            self._place(each.T_reference_query, rows[each.pairs[:, 1]], np.full(1, np.inf, np.float32))
            for each in found[: self._config.max_candidates_when_lost]
            if each.T_reference_query is not None
        ]

    def _search_of(self, segment: int) -> tuple[IntArray, ExhaustiveSearch | None]:
        """The indexed landmarks (M,) of a segment, and the search among them."""
        landmarks = self._map.rows
        rows = self._rows[(landmarks["segment"][self._rows] == segment)]
        rows = rows[landmarks["state"][rows] == LandmarkState.CONFIRMED]
        known = self._searches.get(segment)
        if known is None or not np.array_equal(known[0], rows):
            self._searches[segment] = known = rows, self._make_search(rows) if len(rows) else None
        return known

    def _make_search(self, rows: IntArray) -> ExhaustiveSearch | None:
        reference = placed_submap(self._map, rows, np.zeros(3), self._calibration)
        sigmas = np.full(len(rows), self._calibration.objects.landmark_sigma_m)
        try:
            return ExhaustiveSearch(
                reference.positions,
                reference.labels,
                self._registration_config,
                reach_m=SEARCHED_PAIR_RANGES * self._sensor_range_m,
                map_sigmas=sigmas,
            )
        except GeometryError as error:
            logger.warning("no exhaustive search, retrieval by descriptors alone: %s", error)
            return None

    def _place(self, T_local_query: FloatArray, rows: IntArray, distances: NDArray[np.float32]) -> Place:
        """The place of a pose on which matches with the landmarks ``rows`` (K,) agree."""
        segment, travel_m = traversal_of(self._map, rows, extent_m=self._extent_m)
        return Place(T_local_query, travel_m, segment, float(distances.mean()))

    def first_seen_travels_m(self, submap: Submap) -> FloatArray:
        """Travel [m] at which each landmark (N,) of a submap was first seen."""
        return np.asarray(self._map.rows["first_seen_travel_m"][submap.rows])

    def reference_submap(self, place: Place, *, before_m: float) -> Submap:
        """The landmarks around a place from its traversal, in the odometry frame.

        Those that are seen again by now, because data association never lost them, are of the traversal, too.
        """
        centre = place.T_local_query[:3, 3]
        radius_m = PLACE_RADIUS_RANGES * self._sensor_range_m
        if self._imported is not None and place.segment == SEGMENT:
            self._imported.take_in(centre, radius_m)
        landmarks = self._map.rows
        offsets = landmarks["position_local"][:, :2] - centre[:2]
        rows = np.flatnonzero(
            (landmarks["last_seen_travel_m"] > place.travel_m - self._extent_m)
            & (landmarks["first_seen_travel_m"] < min(place.travel_m + self._extent_m, before_m))
            & (landmarks["segment"] == place.segment)
            & (landmarks["state"] == LandmarkState.CONFIRMED)
            & (np.einsum("ij,ij->i", offsets, offsets) < radius_m**2)
        )
        return placed_submap(self._map, rows, centre, self._calibration)
