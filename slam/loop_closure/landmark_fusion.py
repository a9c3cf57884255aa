"""Fusion of duplicate landmarks: one object that several traversals observed as different landmarks.

A closure associates the newest traversal with one earlier one. Where three traversals overlap, or two overlap for less
travel than lies between two closures, an object may have a landmark for each of them. After the final optimisation
these landmarks have nearly the same position.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from scipy.spatial import cKDTree

from slam.backend.factor_graph import FactorGraph
from slam.common.arrays import FloatArray, IntArray
from slam.object_map.landmarks import LandmarkState, ObjectMap


def fuse_duplicate_landmarks(
    object_map: ObjectMap,
    graph: FactorGraph,
    keyframes: Collection[int],
    *,
    radius_m: float,
    drives: IntArray | None = None,
) -> int:
    """Merge duplicate landmarks until there are none; returns how many were merged into another.

    Two landmarks are duplicates if they have the same class, are mutual nearest neighbours of that class within
    ``radius_m`` in the plane, and no keyframe observed both: two objects that near to each other are seen together. The
    older one stays where it is and is compared again, with the keyframes of both.

    Args:
        object_map: the landmarks.
        graph: their positions, at its current estimate.
        keyframes: only landmarks that one of these observed are compared.
        radius_m: largest horizontal distance of duplicates [m].
        drives: (K,) number of the drive of each keyframe, by date. If given, two landmarks that a keyframe observed
            are duplicates nevertheless where most drives that passed have one of them only.
    """
    merged = 0
    while True:
        observers = graph.observers()
        usable = [
            row
            for row in np.intersect1d(object_map.in_state(LandmarkState.CONFIRMED), graph.landmarks).tolist()
            if not observers[row].isdisjoint(keyframes)
        ]
        rows = np.array(usable, dtype=np.int64)
        nearest = _nearest_alike(graph.landmark_positions(rows), object_map.labels.classes(rows), radius_m)
        before = merged
        for index, other in enumerate(nearest.tolist()):
            kept, dropped = usable[index], usable[other]
            is_mutual = index < other and nearest[other] == index
            if is_mutual and _may_be_one(observers[kept], observers[dropped], drives):
                object_map.merge(kept, dropped)
                merged += 1
        if merged == before:
            return merged
        graph.alias_landmarks(object_map.aliases)


def _may_be_one(a: set[int], b: set[int], drives: IntArray | None) -> bool:
    """Whether no keyframe observed both landmarks, or most drives that passed have one of them rather than both.

    Only drives from the one before the first that has the rarer landmark to the one after the last count: an object
    that came later than the one beside it was not there for the others to see.
    """
    if a.isdisjoint(b) or drives is None:
        return a.isdisjoint(b)
    rare, common = sorted(({int(drives[keyframe]) for keyframe in each} for each in (a, b)), key=len)
    first = max((drive for drive in common if drive < min(rare)), default=min(rare))
    last = min((drive for drive in common if drive > max(rare)), default=max(rare))
    passed = [drive for drive in rare | common if first <= drive <= last]
    return 2 * len(rare & common) < len(passed)


def _nearest_alike(positions: FloatArray, classes: IntArray, radius_m: float) -> IntArray:
    """Index (N,) of the nearest other landmark of the same class within the radius, -1 where there is none."""
    nearest = np.full(len(positions), -1, dtype=np.int64)
    pairs = cKDTree(positions[:, :2]).query_pairs(radius_m, output_type="ndarray").astype(np.int64)
    # Heights are less exact, as the centre of a partly visible object moves up and down.
    alike = (classes[pairs[:, 0]] == classes[pairs[:, 1]]) & (
        np.abs(positions[pairs[:, 0], 2] - positions[pairs[:, 1], 2]) < radius_m / 0.7
    )
    pairs = np.concatenate([pairs[alike], pairs[alike][:, ::-1]])
    apart_m = np.linalg.norm(positions[pairs[:, 0], :2] - positions[pairs[:, 1], :2], axis=1)
    # The last assignment to an index counts, so the nearest comes last; ties go to the lower index.
    order = np.lexsort((-pairs[:, 1], -apart_m))
    nearest[pairs[order, 0]] = pairs[order, 1]
    return nearest
