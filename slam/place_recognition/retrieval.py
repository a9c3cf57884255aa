"""Retrieval: candidate places of a query submap among the landmarks that the robot has left behind.

Inactive landmarks are indexed by what is around them. A map that is imported has an index of its own, which is made
once.
"""

import numpy as np

from descriptors.descriptellation_lr.pair_index import PairIndex
from descriptors.descriptellation_lr.pairs import spacing_m
from descriptors.registry import shipped_likelihood
from slam.common.arrays import BoolArray, FloatArray, IntArray
from slam.common.config import Config
from slam.object_map.landmarks import LandmarkState, ObjectMap, shares_but_one
from slam.object_map.submap import Submap, make_submap
from slam.odometry.pose import OdometryPose
from slam.place_recognition.imported_places import SEGMENT, ImportedPlaces
from slam.place_recognition.landmark_pairs import Batch, make_landmark_pairs
from slam.place_recognition.place_search import Place, PlaceSearch

INACTIVE_RANGES = 2.0
"""A landmark unseen for that travel, in sensor ranges, is added to the index: the robot has left it behind."""
PLACE_RADIUS_RANGES = 3.0
"""Radius of a reference submap, in sensor ranges."""
INDEXED_TRAVERSALS = 4
"""So many traversals of a place are in the index; what more there are would be found no sooner."""


class PlaceRetriever:
    """Retrieves places from an index of inactive landmarks, and from the imported map where one is given."""

    def __init__(self, config: Config, object_map: ObjectMap, imported: ImportedPlaces | None = None) -> None:
        self._imported = imported
        self._count = config.loop_closure.max_candidates
        self._calibration = config.calibration
        self._sensor_range_m = config.sensor_range_m
        self._extent_m = config.traversal_extent_m
        self._map = object_map
        self._pairs = make_landmark_pairs(config)
        self._likelihood = shipped_likelihood()
        self._rows = np.zeros(0, dtype=np.int64)  # landmark of each entry of the index
        self._search: PlaceSearch | None = None
        self._segments, self._shifts_m, self._pitch_m = np.zeros(0, dtype=np.int64), np.zeros(0), 1.0  # side by side
        self._indexed_m, self._indexed_segment = -np.inf, -1

    def index_inactive_landmarks(self, pose: OdometryPose) -> None:
        """Add the landmarks that the robot has left behind, and those of earlier segments, to the index."""
        travel_m, begins = pose.travel_m, pose.segment != self._indexed_segment
        if travel_m - self._indexed_m < self._sensor_range_m / 3.0 and not begins:
            return
        self._indexed_m, self._indexed_segment = travel_m, pose.segment
        landmarks = self._map.rows
        confirmed = landmarks["state"] == LandmarkState.CONFIRMED
        unseen = landmarks["last_seen_travel_m"] < travel_m - INACTIVE_RANGES * self._sensor_range_m
        behind = confirmed & (unseen | (landmarks["segment"] != pose.segment))
        behind[self._rows] = False
        if self._imported is not None:
            behind &= landmarks["segment"] != SEGMENT
        counts = np.bincount(self._map.canonical[self._rows], minlength=len(self._map))
        behind &= counts[self._map.canonical] < INDEXED_TRAVERSALS
        for segment in np.unique(landmarks["segment"][behind]):
            of_segment = landmarks["segment"] == segment
            new = np.flatnonzero(behind & of_segment)
            earliest_m = landmarks["last_seen_travel_m"][new].min() - self._extent_m
            around = np.flatnonzero(confirmed & of_segment & (landmarks["last_seen_travel_m"] > earliest_m))
            self._rows = np.concatenate([self._rows, new])
            entry_of = np.full(len(landmarks), -1)
            entry_of[self._rows] = np.arange(len(self._rows))
            batch = Batch(
                landmarks["position_local"][around],
                self._map.labels.classes(around),
                np.searchsorted(around, new),
                entry_of[around],
                int(segment),
                self._map.labels.vocabulary,
            )
            self._pairs.enter(batch)
            self._search = None

    def class_shares(self) -> FloatArray:
        """Share (C,) of each class among the objects of the index or of the imported map but one of that class."""
        counts, imported = np.zeros(len(self._map.labels.vocabulary)), self._imported
        if imported is not None:
            counts[: len(imported.class_counts)] = imported.class_counts
        else:
            np.add.at(counts, self._map.labels.classes(np.unique(self._map.canonical[self._rows])), 1.0)
        return shares_but_one(counts, counts - 1.0, (max(int(counts.sum()), 1), len(counts)))

    def propose(self, query: Submap, *, before_m: float) -> list[Place]:
        """The best places of a query, given in its gravity frame: ``max_candidates`` of each index.

        Those by descriptors, among landmarks seen before that travel, come first, then those in the imported map.
        """
        landmarks = self._map.rows
        usable = (landmarks["last_seen_travel_m"] < before_m) & (landmarks["state"] == LandmarkState.CONFIRMED)
        places = self._places(query, usable[self._rows])
        return places if self._imported is None else places + self._imported.propose(query, count=self._count)

    def _places(self, query: Submap, allowed: BoolArray) -> list[Place]:
        """The likeliest places of a query among entries that are ``allowed`` (M,)."""
        if not len(query) or not allowed.any():
            return []
        if self._search is None:
            self._search = self._side_by_side()
        positions, of = (self._map.rows[name][self._rows] for name in ("position_local", "segment"))
        middle = np.append(query.positions.mean(axis=0), 1.0)
        radius_m = np.linalg.norm(query.positions[:, :2] - middle[:2], axis=1).max()
        places = []
        for T in self._search.find_poses(query, count=self._count, allowed=allowed):
            slot = int((T @ middle)[0] // self._pitch_m)
            if not 0 <= slot < len(self._segments):
                continue
            T[0, 3] -= self._shifts_m[slot]
            segment = int(self._segments[slot])
            offsets = positions[:, :2] - (T @ middle)[:2]
            near = allowed & (of == segment) & (np.hypot(*offsets.T) <= radius_m)
            if near.any():
                places.append(Place(T, self._traversal_m(self._rows[near]), segment, "descriptor"))
        return places

    def _side_by_side(self) -> PlaceSearch:
        """All entries in one map, those of each segment of the odometry apart from the others, along x."""
        placed, of = self._map.rows["position_local"][self._rows], self._map.rows["segment"][self._rows]
        self._segments, slots = np.unique(of, return_inverse=True)
        ends_m = np.array([(placed[of == each, 0].min(), placed[of == each, 0].max()) for each in self._segments])
        self._pitch_m = 2.0 * np.diff(ends_m).max() + 1e3 * spacing_m(placed)
        self._shifts_m = (np.arange(len(ends_m)) + 0.25) * self._pitch_m - ends_m[:, 0]
        placed[:, 0] += self._shifts_m[slots]
        return PlaceSearch(self._pairs, placed, self._map.labels.classes(self._rows), len(self._map.labels.vocabulary))

    def _traversal_m(self, rows: IntArray) -> float:
        """Middle travel [m] of the traversal that most of the landmarks ``rows`` (K,) of a segment are from.

        A place that was passed several times has landmarks from each of the passes.
        """
        travels_m = np.sort(self._map.rows["first_seen_travel_m"][rows])
        ends = np.searchsorted(travels_m, travels_m + 2.0 * self._extent_m, side="right")
        start = int(np.argmax(ends - np.arange(len(ends))))
        return float(np.median(travels_m[start : ends[start]]))

    def self_similar_poses(self, query: Submap) -> FloatArray:
        """Poses (H, 4, 4) of a query in itself at which its objects repeat: the identity, and as many as a query in the
        map has candidates.
        """
        pairs = PairIndex(self._likelihood)
        pairs.add(query.positions, query.labels)
        search = PlaceSearch(pairs, query.positions, query.labels, len(self._map.labels.vocabulary))
        sigma_m = self._calibration.objects.landmark_sigma_m
        return search.find_poses(query, map_sigma_m=sigma_m, count=self._count + 1)

    def reference_submap(self, place: Place, *, before_m: float) -> Submap:
        """The landmarks around a place from its traversal that were not seen since ``before_m``, odometry frame.

        Those that were have moved with the robot, and data association compares what is seen with them.
        """
        centre = place.T_local_query[:3, 3]
        radius_m = PLACE_RADIUS_RANGES * self._sensor_range_m
        if self._imported is not None and place.segment == SEGMENT:
            self._imported.load_landmarks_near(centre, radius_m)
        landmarks = self._map.rows
        offsets = landmarks["position_local"][:, :2] - centre[:2]
        rows = np.flatnonzero(
            (landmarks["last_seen_travel_m"] > place.travel_m - self._extent_m)
            & (landmarks["first_seen_travel_m"] < place.travel_m + self._extent_m)
            & (landmarks["last_seen_travel_m"] < before_m)
            & (landmarks["segment"] == place.segment)
            & (landmarks["state"] == LandmarkState.CONFIRMED)
            & (np.einsum("ij,ij->i", offsets, offsets) < radius_m**2)
        )
        return make_submap(self._map, rows, landmarks["position_local"][rows], centre, self._calibration)
