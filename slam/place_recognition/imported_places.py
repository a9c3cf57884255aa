"""Places of a query in an imported map, whose landmarks are loaded only around these.

The landmarks of the map around a pose, where it is verified and while the robot is tracked there, become landmarks of
the object map.
"""

import numpy as np

from slam.backend.factor_graph import FactorGraph
from slam.common.arrays import FloatArray
from slam.object_map.landmarks import ObjectMap
from slam.object_map.submap import Submap
from slam.place_recognition.imported_map import ImportedMap
from slam.place_recognition.place_search import Place

TRAVEL_M = -1e9
"""Travel of everything in a prior map. It has no traversals: all of it is consistent. Longer ago than any drive is
long."""
SEGMENT = 0
HEIGHT_SIGMA_M = 1e3
"""Of objects in a map without heights."""


class ImportedPlaces:
    """Proposes places in an imported map, and loads its landmarks.

    Args:
        imported: the map.
        object_map: gets landmarks of the map as segment 0; its vocabulary begins with that of the map.
        graph: gets their positions.
        is_fixed: whether the landmarks stay where they are.
    """

    def __init__(self, imported: ImportedMap, object_map: ObjectMap, graph: FactorGraph, *, is_fixed: bool) -> None:
        object_map.labels.indices(imported.vocabulary)
        self._imported = imported
        self._map = object_map
        self._graph = graph
        self._is_fixed = is_fixed
        height_sigma_m = HEIGHT_SIGMA_M if is_flat(imported) else imported.sigma_m
        self._sigmas_m = np.array([imported.sigma_m, imported.sigma_m, height_sigma_m])
        self.class_counts = np.bincount(imported.classes)
        """How many objects (C,) of each class the map has."""
        imported.pairs.read_ahead()
        self._search = imported.search()
        self._is_loaded = np.zeros(len(imported), dtype=np.bool_)

    @property
    def positions(self) -> FloatArray:
        """Positions (N, 2) m of all objects of the map."""
        return self._imported.positions[:, :2]

    def propose(self, query: Submap, *, count: int) -> list[Place]:
        """The ``count`` likeliest places of a query, given in its gravity frame."""
        poses = self._search.find_poses(query, map_sigma_m=self._imported.sigma_m, count=count)
        return [Place(T_local_query, TRAVEL_M, SEGMENT, "map index") for T_local_query in poses]

    def load_landmarks_near(self, place: FloatArray, radius_m: float) -> None:
        """Add the objects of the map within ``radius_m`` of a place (3,) m as landmarks, each once."""
        rows = self._search.near(place[:2], radius_m)
        rows = rows[~self._is_loaded[rows]]
        if not len(rows):
            return
        self._is_loaded[rows] = True
        record = self._imported.landmarks(rows, observations=1)
        landmarks = self._map.restore(record, travel_m=TRAVEL_M, relative_sigma_m=self._imported.sigma_m)
        positions = dict(zip(landmarks.tolist(), record.positions, strict=True))
        self._graph.add_known_landmarks(positions, self._sigmas_m, is_fixed=self._is_fixed)


def is_flat(imported: ImportedMap) -> bool:
    """Whether a map has no heights."""
    return bool(np.ptp(imported.positions[:, 2]) == 0.0)
