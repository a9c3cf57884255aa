"""Indexes of the landmarks that a robot has left behind: what a descriptor says of where a query may be among them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from descriptors.constellation import Constellations, gather_constellations
from descriptors.descriptellation_lr.pair_index import PairIndex
from descriptors.descriptellation_lr.pairs import spacing_m
from descriptors.index import VectorIndex
from descriptors.registry import make_index
from slam.common.arrays import BoolArray, FloatArray, IntArray
from slam.common.config import Config
from slam.object_map.submap import Submap
from slam.place_recognition.place_search import PlaceSearch
from slam.registration.parameters import registration_config
from slam.registration.registration import register

DESCRIPTOR_RANGE_M = 30.0
"""Sensor range for which vectors of constellations are made: their rings and radii are lengths of their own."""
ADDED_AT_ONCE = 50_000
"""Constellations that are in memory at the same time."""
SPACING_FACTOR = 1.25
"""If the spacing of the landmarks has changed by that factor since their pairs were indexed, they are indexed again."""


@dataclass(frozen=True, slots=True, eq=False)
class Batch:
    """Landmarks that are added at once, and those around them: ``positions`` (N, 3) m and ``labels`` (N,) of both, in
    the odometry frame of the ``segment``; ``centres`` (C,): rows of the new ones; ``entries`` (N,): numbers of all in
    the index, -1 of those that it does not have.
    """

    positions: FloatArray
    labels: IntArray
    centres: IntArray
    entries: IntArray
    segment: int


class LandmarkIndex(Protocol):
    """Entries are landmarks, numbered in the order in which they were added."""

    def add(self, batch: Batch, vocabulary: tuple[str, ...]) -> None:
        """Add landmarks."""

    def propose(self, query: Submap, allowed: BoolArray, count: int) -> list[tuple[FloatArray, IntArray]]:
        """At most ``count`` poses (4, 4) of a query, the likeliest first, each with entries (K,) around it that are
        ``allowed`` (M,).
        """


def make_landmark_index(config: Config) -> LandmarkIndex:
    """The index for the descriptor of the settings.

    Raises:
        DescriptorError: there is none of that name.
    """
    index = make_index(config.loop_closure.descriptor)
    return LandmarkPairs(index) if isinstance(index, PairIndex) else LandmarkVectors(config, index)


class LandmarkPairs:
    """The learned likelihood ratio of pairs."""

    def __init__(self, index: PairIndex) -> None:
        self._index = index
        self._batches = list[Batch]()
        self._search: PlaceSearch | None = None
        self._positions, self._segments = np.zeros((0, 3)), np.zeros(0, dtype=np.int64)
        self._labels = np.zeros(0, dtype=np.int64)
        self._shifts_m, self._pitch_m = {0: 0.0}, 1.0

    def add(self, batch: Batch, vocabulary: tuple[str, ...]) -> None:
        """Add landmarks."""
        del vocabulary  # classes are compared by their numbers
        self._batches.append(batch)
        new = batch.centres
        self._positions = np.concatenate([self._positions, batch.positions[new]])
        self._labels = np.concatenate([self._labels, batch.labels[new]])
        self._segments = np.concatenate([self._segments, np.full(len(new), batch.segment)])
        unit_m = spacing_m(batch.positions) if len(self._batches) == 1 else spacing_m(self._positions)
        if self._index.unit_m is None or abs(np.log(unit_m / self._index.unit_m)) > np.log(SPACING_FACTOR):
            self._index = self._index.emptied(unit_m)
            for each in self._batches:
                self._enter(each)
        else:
            self._enter(batch)
        self._search = None

    def _enter(self, batch: Batch) -> None:
        self._index.add(batch.positions, batch.labels, numbers=batch.entries, centres=batch.centres)

    def propose(self, query: Submap, allowed: BoolArray, count: int) -> list[tuple[FloatArray, IntArray]]:
        """At most ``count`` poses (4, 4) of a query, the likeliest first, with the entries around each."""
        if not len(query) or not allowed.any():
            return []
        if self._search is None:
            self._search = self._side_by_side()
        poses = self._search.find_poses(query, count=count, allowed=allowed)
        middle = np.append(query.positions.mean(axis=0), 1.0)
        radius_m = float(np.linalg.norm(query.positions[:, :2] - middle[:2], axis=1).max())
        slots = dict(enumerate(self._shifts_m))
        places = []
        for T in poses:
            segment = slots.get(int((T @ middle)[0] // self._pitch_m))
            if segment is None:
                continue
            T[0, 3] -= self._shifts_m[segment]
            offsets = self._positions[:, :2] - (T @ middle)[:2]
            near = np.flatnonzero(allowed & (self._segments == segment) & (np.hypot(*offsets.T) <= radius_m))
            if len(near):
                places.append((T, near))
        return places

    def _side_by_side(self) -> PlaceSearch:
        """All landmarks in one map, those of each segment of the odometry apart from the others, along x."""
        segments = np.unique(self._segments).tolist()
        xs_m = [self._positions[self._segments == segment, 0] for segment in segments]
        self._pitch_m = 2.0 * max(float(np.ptp(x_m)) for x_m in xs_m) + 1e3 * spacing_m(self._positions)
        self._shifts_m = {
            segment: (slot + 0.25) * self._pitch_m - float(x_m.min())
            for slot, (segment, x_m) in enumerate(zip(segments, xs_m, strict=True))
        }
        placed = self._positions.copy()
        placed[:, 0] += np.vectorize(self._shifts_m.__getitem__, otypes=[float])(self._segments)
        return PlaceSearch(self._index, placed, self._labels, int(self._labels.max()) + 1)


class LandmarkVectors:
    """Vectors of constellations, whose nearest neighbours are registered."""

    def __init__(self, config: Config, index: VectorIndex) -> None:
        self._config, self._index = config, index
        self._scale = DESCRIPTOR_RANGE_M / config.sensor_range_m
        self._registering = registration_config(config)
        self._positions = np.zeros((0, 3))
        self._vocabulary: tuple[str, ...] = ()

    def add(self, batch: Batch, vocabulary: tuple[str, ...]) -> None:
        """Add landmarks."""
        self._vocabulary = vocabulary
        for start in range(0, len(batch.centres), ADDED_AT_ONCE):
            centres = batch.centres[start : start + ADDED_AT_ONCE]
            self._index.add(self._constellations(batch.positions, batch.labels, centres))
        self._positions = np.concatenate([self._positions, batch.positions[batch.centres]])

    def propose(self, query: Submap, allowed: BoolArray, count: int) -> list[tuple[FloatArray, IntArray]]:
        """At most ``count`` poses (4, 4) of a query, the best supported first, with the entries that support each."""
        if not len(query) or not allowed.any():
            return []
        known = np.flatnonzero(query.labels < len(self._vocabulary))
        asked = self._constellations(query.positions[known], query.labels[known])
        matches = self._index.search(asked, self._config.loop_closure.top_k, allowed)
        if not len(matches.queries):
            return []
        entries, references = np.unique(matches.entries, return_inverse=True)
        registrations = register(
            query.positions[known],
            self._positions[entries],
            np.column_stack([matches.queries, references]),
            self._registering,
            query_sigmas=query.sigmas[known],
            reference_sigmas=np.full(len(entries), self._config.calibration.objects.landmark_sigma_m),
            count=count,
        )
        return [
            (found.T_reference_query, entries[found.pairs[:, 1]])
            for found in registrations
            if found.T_reference_query is not None
        ]

    def _constellations(
        self, positions: FloatArray, labels: IntArray, centres: IntArray | None = None
    ) -> Constellations:
        """Constellations of objects (N, 3) m, scaled to a sensor that sees as far as the descriptors are made for."""
        return gather_constellations(
            positions * self._scale, labels, self._vocabulary, radius_m=self._index.radius_m, centres=centres
        )
