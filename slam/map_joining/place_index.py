"""One index for the landmarks of many maps: they stand side by side in one frame, and a query finds any of them.

It is an imported map (memory-mapped tiles and quads), so the time of a query does not grow with the number of maps.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from slam.common.arrays import FloatArray, IntArray
from slam.object_map.map_io import SavedMap
from slam.object_map.submap import Submap
from slam.place_recognition.imported_map import ImportedMap, make_imported_map
from slam.place_recognition.map_search import MapSearch

OFFSETS, PITCH = "offsets", "pitch_m"


@dataclass(frozen=True, slots=True, eq=False)
class FoundPlace:
    """``T_map_query`` (4, 4) in the frame of the map with the number ``map_number``."""

    map_number: int
    T_map_query: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class PlaceIndex:
    """``objects`` of all maps, and their ``search``; ``offsets`` (M, 3) m: where the origin of each lies, in a square
    of ``pitch_m``.
    """

    objects: ImportedMap
    search: MapSearch
    offsets: FloatArray
    pitch_m: float

    def maps_of(self, positions: FloatArray) -> IntArray:
        """The map (N,) in whose square positions (N, 2 or 3) lie."""
        side = _side(len(self.offsets))
        cells = np.floor(positions[:, :2] / self.pitch_m).astype(np.int64)
        is_inside = ((cells >= 0) & (cells < side)).all(axis=1)
        numbers = cells[:, 1] * side + cells[:, 0]
        return np.where(is_inside & (numbers < len(self.offsets)), numbers, -1)

    def name_of(self, row: int) -> str:
        """The id of a landmark in its map, by its row in ``objects``."""
        return str(self.objects.ids[row].decode()).partition("/")[2]

    def labels_of(self, names: Sequence[str]) -> IntArray:
        """Classes (N,) as the index numbers them; -1 for one that it does not have."""
        number = {name: place for place, name in enumerate(self.objects.vocabulary)}
        return np.array([number.get(name, -1) for name in names], dtype=np.int64)

    def find(self, query: Submap, *, count: int, before: int) -> list[FoundPlace]:
        """The ``count`` likeliest poses of a query in its gravity frame, in the maps with numbers below ``before``."""
        known = np.flatnonzero(query.labels >= 0)
        sigma_m = float(np.hypot(np.median(query.sigmas), self.objects.sigma_m)) if len(known) else 0.0
        poses = self.search.find_poses(
            query.positions[known],
            query.labels[known],
            sigma_m=sigma_m,
            count=count,
            is_excluded=lambda rows: self.maps_of(self.objects.positions[rows].astype(np.float64)) >= before,
        )
        if not len(poses):
            return []
        middle = np.append(query.positions[known].mean(axis=0), 1.0)
        places = []
        for T_index_query in poses:
            number = int(self.maps_of((T_index_query @ middle)[None, :2])[0])
            if 0 <= number < before:
                T_map_query = T_index_query.copy()
                T_map_query[:3, 3] -= self.offsets[number]
                places.append(FoundPlace(number, T_map_query))
        return places

    def submap(self, map_number: int, centre: FloatArray, radius_m: float, *, sigma_m: float) -> Submap:
        """The landmarks of a map within ``radius_m`` of a point (3,) of it, in its frame."""
        offset = self.offsets[map_number]
        rows = self.objects.near(centre[:2] + offset[:2], radius_m)
        rows = rows[self.maps_of(self.objects.positions[rows, :2].astype(np.float64)) == map_number]
        positions = self.objects.positions[rows].astype(np.float64) - offset
        is_near = np.hypot(*(positions[:, :2] - centre[:2]).T) <= radius_m
        rows, positions = rows[is_near], positions[is_near]
        return Submap(positions, np.full(len(rows), sigma_m), self.objects.classes[rows].astype(np.int64), rows)


def make_place_index(maps: Sequence[SavedMap], *, sigma_m: float) -> PlaceIndex:
    """The index of maps, numbered in their order.

    Args:
        maps: with landmarks.
        sigma_m: how far a landmark of one map and the same of another are apart, in each coordinate.

    Raises:
        SavedMapError: fewer than four landmarks in all.
    """
    extents_m = [float(np.ptp(each.objects.positions[:, :2], axis=0).max()) for each in maps]
    pitch_m = 1.5 * max(extents_m) + 1e3 * sigma_m
    side = _side(len(maps))
    corners = np.array([(pitch_m * (number % side), pitch_m * (number // side), 0.0) for number in range(len(maps))])
    lows = np.array([[*each.objects.positions[:, :2].min(axis=0), 0.0] for each in maps])
    offsets = corners + np.array([0.25 * pitch_m, 0.25 * pitch_m, 0.0]) - lows
    positions = np.concatenate([each.objects.positions + at for each, at in zip(maps, offsets, strict=True)])
    labels = [label for each in maps for label in each.objects.labels]
    ids = [f"{number}/{name}" for number, each in enumerate(maps) for name in each.objects.ids]
    source = {OFFSETS: json.dumps(offsets.tolist()), PITCH: repr(pitch_m)}
    return opened_place_index(make_imported_map(positions, labels, ids, sigma_m=sigma_m, source=source))


def opened_place_index(objects: ImportedMap) -> PlaceIndex:
    """The index whose objects were saved as an imported map."""
    about = objects.metadata
    return PlaceIndex(objects, objects.search(), np.array(json.loads(about[OFFSETS])), float(about[PITCH]))


def _side(count: int) -> int:
    return int(np.ceil(np.sqrt(count)))
