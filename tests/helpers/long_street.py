"""The first streets of a generated town as a map of labelled objects, and what is seen from places in them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from logs.messages import ObjectMapRecord
from slam.common.arrays import FloatArray, IntArray
from slam.common.geometry import apply, invert, transform_from_xyz_yaw
from tests.helpers.driven_maps import town

RANGE_M = 30.0


@dataclass(frozen=True)
class StreetMap:
    """Objects (M, 3) m with labels (M,) in ``vocabulary``."""

    positions: FloatArray
    labels: IntArray
    vocabulary: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.labels)

    def to_record(self) -> ObjectMapRecord:
        """The same as confirmed landmarks, each of them seen once and known exactly."""
        ids = tuple(map(str, range(len(self))))
        return ObjectMapRecord.of_objects(ids, self.positions, self.labels, self.vocabulary, observations=1)


@dataclass(frozen=True)
class LocalQuery:
    """Objects (N, 3) m seen from a pose (4, 4), and which of the map they are."""

    positions: FloatArray
    labels: IntArray
    objects: IntArray
    T_map_query_gt: FloatArray

    def __len__(self) -> int:
        return len(self.labels)


def start_of_street(length_m: float) -> tuple[StreetMap, FloatArray]:
    """The objects within range of the first part of the tour, and that part."""
    world = town(4).shortened(length_m)
    labels = np.searchsorted(world.vocabulary, world.labels)
    near = np.min([np.hypot(*(world.positions[:, :2] - place).T) for place in world.tour], axis=0) < RANGE_M
    return StreetMap(world.positions[near], labels[near], world.vocabulary), world.tour


def draw_queries(objects: StreetMap, tour: FloatArray, *, count: int, rng: np.random.Generator) -> list[LocalQuery]:
    """All objects in range of random places of the tour, with a random heading."""
    queries = []
    for place in rng.choice(tour, count):
        seen = np.flatnonzero(np.hypot(*(objects.positions[:, :2] - place).T) < RANGE_M)
        height_m = np.median(objects.positions[seen, 2])
        T_map_query = transform_from_xyz_yaw(np.append(place, height_m), rng.uniform(-np.pi, np.pi))
        local = apply(invert(T_map_query), objects.positions[seen])
        queries.append(LocalQuery(local, objects.labels[seen], seen, T_map_query))
    return queries
