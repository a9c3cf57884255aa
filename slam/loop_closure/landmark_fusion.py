"""Landmarks that the optimised map puts at one place: two passes saw one object, and no closure told so.

Closures compare the newest pass with one earlier one. Where three passes meet, or two for less travel than lies between
two closures, an object may have a landmark for each of them. Once all closures are made they stand at one place.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from scipy.spatial import cKDTree

from slam.backend.factor_graph import FactorGraph
from slam.common.arrays import FloatArray, IntArray
from slam.object_map.landmarks import LandmarkState, ObjectMap

MAX_HEIGHT_M = 1.0
"""Heights say less: of an object that is seen in part the centre moves up and down."""


def find_coincident(
    object_map: ObjectMap, graph: FactorGraph, keyframes: Collection[int], *, radius_m: float
) -> list[tuple[int, int]]:
    """Pairs of landmarks that are one, the older one first, no landmark twice.

    Two landmarks are one if they are of one class, stand within ``radius_m`` of one another in the plane, nearer than
    any other of that class, and if no keyframe has ever seen both: two objects that stand so near are seen together.

    Args:
        object_map: the landmarks.
        graph: where they are, at its current estimate.
        keyframes: only what one of these saw is looked at: those whose place is well known relative to earlier ones.
        radius_m: how far apart at the most.
    """
    observers = graph.observers()
    usable = [
        row
        for row in np.intersect1d(object_map.in_state(LandmarkState.CONFIRMED), graph.landmarks).tolist()
        if not observers[row].isdisjoint(keyframes)
    ]
    rows = np.array(usable, dtype=np.int64)
    if not len(rows):
        return []
    nearest = _nearest_alike(graph.landmark_positions(rows), object_map.classes(rows), radius_m)
    return [
        (int(rows[place]), int(rows[other]))
        for place, other in enumerate(nearest.tolist())
        if place < other
        and nearest[other] == place
        and observers[int(rows[place])].isdisjoint(observers[int(rows[other])])
    ]


def merge_coincident(object_map: ObjectMap, graph: FactorGraph, keyframes: Collection[int], *, radius_m: float) -> int:
    """Make one of the landmarks that are one, until there are none; returns how many lost their names."""
    merged = 0
    while pairs := find_coincident(object_map, graph, keyframes, radius_m=radius_m):
        for kept, dropped in pairs:
            object_map.merge(kept, dropped)
            graph.merge_landmarks(kept, dropped)
        merged += len(pairs)
    return merged


def _nearest_alike(positions: FloatArray, classes: IntArray, radius_m: float) -> IntArray:
    """The place (N,) of the nearest other of the same class within the radius, -1 where there is none."""
    nearest = np.full(len(positions), -1, dtype=np.int64)
    pairs = cKDTree(positions[:, :2]).query_pairs(radius_m, output_type="ndarray").astype(np.int64)
    alike = (classes[pairs[:, 0]] == classes[pairs[:, 1]]) & (
        np.abs(positions[pairs[:, 0], 2] - positions[pairs[:, 1], 2]) < MAX_HEIGHT_M
    )
    pairs = np.concatenate([pairs[alike], pairs[alike][:, ::-1]])
    apart_m = np.linalg.norm(positions[pairs[:, 0], :2] - positions[pairs[:, 1], :2], axis=1)
    # The last assignment to a place counts, so the nearest comes last; ties go to the lower place.
    order = np.lexsort((-pairs[:, 1], -apart_m))
    nearest[pairs[order, 0]] = pairs[order, 1]
    return nearest
