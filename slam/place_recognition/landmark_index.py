"""Index of the landmarks that a robot has left behind: where a query may be among them."""

from __future__ import annotations

import numpy as np

from descriptors.descriptellation_lr.pairs import spacing_m
from slam.common.arrays import BoolArray, FloatArray, IntArray
from slam.common.config import Config
from slam.object_map.submap import Submap
from slam.place_recognition.landmark_pairs import Batch, make_landmark_pairs
from slam.place_recognition.place_search import PlaceSearch


class LandmarkIndex:
    """Entries are landmarks, numbered in the order in which they were added."""

    def __init__(self, config: Config) -> None:
        self._pairs = make_landmark_pairs(config)
        self._search: PlaceSearch | None = None
        self._positions, self._segments = np.zeros((0, 3)), np.zeros(0, dtype=np.int64)
        self._labels = np.zeros(0, dtype=np.int64)
        self._shifts_m, self._pitch_m = {0: 0.0}, 1.0

    def add(self, batch: Batch, vocabulary: tuple[str, ...]) -> None:
        """Add landmarks."""
        new = batch.centres
        self._positions = np.concatenate([self._positions, batch.positions[new]])
        self._labels = np.concatenate([self._labels, batch.labels[new]])
        self._segments = np.concatenate([self._segments, np.full(len(new), batch.segment)])
        self._pairs.add(batch, vocabulary)
        self._search = None

    def propose(self, query: Submap, allowed: BoolArray, count: int) -> list[tuple[FloatArray, int, IntArray]]:
        """At most ``count`` poses (4, 4) of a query, the likeliest first, each with its segment and the entries (K,) of
        that around it that are ``allowed`` (M,).
        """
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
                places.append((T, segment, near))
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
        return PlaceSearch(self._pairs, placed, self._labels, int(self._labels.max()) + 1)
