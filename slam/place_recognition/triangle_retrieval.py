"""Retrieval of places by triangles of landmarks, which works without classes."""

from __future__ import annotations

import numpy as np

from slam.common.arrays import BoolArray, FloatArray, IntArray
from slam.object_map.landmarks import ObjectMap
from slam.object_map.submap import Submap
from slam.place_recognition.place import Place, traversal_of
from slam.place_recognition.triangle_index import TriangleIndex
from slam.place_recognition.triangle_voting import vote_for_poses

TOLERANCE_SIGMAS = 1.4
"""Difference of two sides, in standard deviations, up to which they may be equal. Right votes, with three sides within
t sigmas, are erf(t / sqrt 2)^3 of all, and the noise of the wrong ones is as t^1.5: their ratio is highest here."""
SIDE_SIGMAS = 2.0
"""Standard deviation of the difference of two sides, in those of a coordinate of one landmark: it has four ends."""


class TriangleRetriever:
    """Retrieves places of queries by the triangles of inactive landmarks.

    Args:
        object_map: of the landmarks.
        landmark_sigma_m: their noise between two traversals, per coordinate.
        extent_m: how far a traversal reaches before and after a place.
    """

    def __init__(self, object_map: ObjectMap, *, landmark_sigma_m: float, extent_m: float) -> None:
        self._map = object_map
        self._extent_m = extent_m
        self._index = TriangleIndex(TOLERANCE_SIGMAS * SIDE_SIGMAS * landmark_sigma_m)

    def add(self, rows: IntArray, new: IntArray) -> None:
        """Add the triangles of the landmarks ``rows[new]`` (K,) with those around them, ``rows`` (N,)."""
        self._index.add(self._map.rows["position_local"][rows], self._map.classes(rows), rows, new)

    def aliases(self, query: Submap, *, count: int) -> FloatArray:
        """``T_query_alias`` (H, 4, 4): poses at which most triangles of a query meet others of its own.

        The first is the identity; at the others a regular pattern repeats itself.
        """
        rows = np.arange(len(query))
        own = TriangleIndex(self._index.tolerance_m)
        own.add(query.positions, query.labels, rows, rows)
        matches = own.match(query.positions, query.labels, np.ones(len(query), dtype=np.bool_))
        poses = vote_for_poses(
            query.positions, query.positions, matches, tolerance_m=self._index.tolerance_m, count=count
        )
        return np.stack([np.eye(4), *(pose.T_reference_query for pose in poses)])

    def retrieve(self, query: Submap, usable: BoolArray, *, count: int) -> list[Place]:
        """The ``count`` places with most votes of the triangles of a query, among the ``usable`` landmarks (L,)."""
        matches = self._index.match(query.positions, query.labels, usable)
        poses = vote_for_poses(
            query.positions,
            self._map.rows["position_local"],
            matches,
            tolerance_m=self._index.tolerance_m,
            count=count,
        )
        places = []
        for pose in poses:
            landmarks = matches.reference[pose.matches].ravel()
            segment, travel_m = traversal_of(self._map, landmarks, extent_m=self._extent_m)
            places.append(Place(pose.T_reference_query, travel_m, segment, np.inf))
        return places
