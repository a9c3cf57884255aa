"""Fusion of duplicate landmarks: one object that has several of them.

A closure associates the newest traversal with one earlier one. Where three traversals overlap, or two overlap for less
travel than lies between two closures, an object may have a landmark for each of them. So it may where the robot comes
back with a larger error than the odometry is expected to have.
"""

from __future__ import annotations

import logging
from collections import defaultdict
from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np
from scipy.spatial import cKDTree

from slam.backend.factor_graph import FactorGraph
from slam.common.arrays import FloatArray, IntArray
from slam.common.calibration import ObjectCalibration
from slam.common.errors import FactorGraphError
from slam.common.geometry import squared_mahalanobis
from slam.frontend.data_association import DECIDED
from slam.object_map.landmarks import LandmarkState, ObjectMap
from slam.odometry.noise import FREEDOM

logger = logging.getLogger(__name__)

LEAST_LOG_ODDS = float(np.log(DECIDED / (1.0 - DECIDED)))
"""Log-likelihood ratio from which landmarks are taken to be one object."""
SIGNIFICANT = 0.05
"""Labels are taken for identities where random ones were so unlikely."""


def fuse_landmarks(object_map: ObjectMap, graph: FactorGraph, config: ObjectCalibration) -> int:
    """Merge landmarks that are one object until there are none, and optimise the graph; returns how many were merged.

    That two confirmed landmarks of a class are one object has the log-likelihood ratio

        log t(d; 0, S + R) - log rho - (1 - m) log(1 - P_D),

    with their offset d, its covariance S in the graph, and R of landmarks of one object in two traversals; the density
    rho of objects of a class on the ground; and the number m of keyframes that observed both. All that observed
    one of them count as one look: what hides one of two objects does so for a while. Landmarks are merged if the
    probability is ``DECIDED``, also against another landmark that one of them may be, seen beside the other.
    """
    merged = 0
    while pairs := _one_object(object_map, graph, config):
        for kept, dropped in pairs:
            object_map.merge(kept, dropped)
        merged += len(pairs)
        graph.alias_landmarks(object_map.aliases)
        graph.optimize(roughly=True)
    return merged


def _one_object(object_map: ObjectMap, graph: FactorGraph, config: ObjectCalibration) -> list[tuple[int, int]]:
    """Pairs of landmarks that are one object, the older one first; none is in two of them."""
    rows = np.intersect1d(object_map.in_state(LandmarkState.CONFIRMED), graph.landmarks)
    if len(rows) < 2:
        return []
    positions, classes, observers = graph.landmark_positions(rows), object_map.labels.classes(rows), graph.observers()
    log_density = _log_density(positions, classes, [observers[row] for row in rows.tolist()], config.spacing_m)
    missed = -np.log(1.0 - min(config.detection_probability, DECIDED))
    # No covariance makes the likelihood of an offset that is longer large enough.
    reach_m = float(np.exp(0.5 * (missed - LEAST_LOG_ODDS - log_density - 1.0 - np.log(np.pi))))
    pairs = _pairs_alike(positions, classes, reach_m)
    if not len(pairs):
        return []
    d, pairs = positions[pairs[:, 0]] - positions[pairs[:, 1]], rows[pairs]
    try:
        covariances = graph.relative_covariances(pairs)
    except FactorGraphError as error:
        logger.info("duplicate landmarks are not merged: %s", error)
        return []
    height_m = np.hypot(config.landmark_sigma_m, config.landmark_height_sigma_m)
    S = covariances + np.diag([config.landmark_sigma_m, config.landmark_sigma_m, height_m]) ** 2
    together = np.array([len(observers[a] & observers[b]) for a, b in pairs.tolist()])
    tail = (FREEDOM + 3.0) * np.log1p(squared_mahalanobis(d, S) / FREEDOM)
    log_area = np.log((2.0 * np.pi) ** 2 * np.linalg.det(S[:, :2, :2]))
    ratios = -0.5 * (tail + log_area) - log_density + missed * (1 - together)
    likely = ratios > LEAST_LOG_ODDS
    return _sure(dict(zip(map(tuple, pairs[likely].tolist()), ratios[likely].tolist(), strict=True)), observers)


def _sure(ratios: Mapping[tuple[int, int], float], observers: Mapping[int, set[int]]) -> list[tuple[int, int]]:
    """Of pairs with their log-likelihood ratios, those of which no landmark is nearly as likely another object's: one
    that was seen beside the other. No landmark is in two of them; the likeliest ones are chosen.
    """
    partners = defaultdict[int, dict[int, float]](dict)
    for (a, b), ratio in ratios.items():
        partners[a][b] = partners[b][a] = ratio
    chosen, used = list[tuple[int, int]](), set[int]()
    for (a, b), ratio in sorted(ratios.items(), key=lambda item: -item[1]):
        rivals = [
            rival
            for one, other in ((a, b), (b, a))
            for third, rival in partners[one].items()
            if third != other and not observers[third].isdisjoint(observers[other])
        ]
        if max(rivals, default=-np.inf) < ratio - LEAST_LOG_ODDS and used.isdisjoint((a, b)):
            chosen.append((a, b))
            used |= {a, b}
    return sorted(chosen)


def _log_density(positions: FloatArray, classes: IntArray, observers: Sequence[set[int]], spacing_m: float) -> float:
    """Log of the density [1/m^2] of objects of a class: half of them have another one within the spacing.

    Where no scan has two objects of a class, labels may be identities, or the sensor sees few objects at once: of the
    pairs of classes that keyframes observed together, some would be equal if labels were random. Unless that is
    significant, it is the density of all landmarks (L,).
    """
    extent_m = np.ptp(positions[:, :2], axis=0)
    if spacing_m > extent_m.max():
        kinds = defaultdict[int, set[int]](set)
        for kind, keyframes in zip(classes.tolist(), observers, strict=True):
            for keyframe in keyframes:
                kinds[keyframe].add(kind)
        pairs = {pair for each in kinds.values() for pair in combinations(sorted(each), 2)}
        share = float(np.sum((np.bincount(classes) / len(classes)) ** 2))
        if (1.0 - share) ** len(pairs) > SIGNIFICANT:
            return float(np.log(len(classes) / np.prod(np.maximum(extent_m, 1e-9))))
    return float(np.log(np.log(2.0) / (np.pi * spacing_m**2)))


def _pairs_alike(positions: FloatArray, classes: IntArray, reach_m: float) -> IntArray:
    """Pairs (P, 2) of landmarks of one class that are within reach of one another, ascending."""
    found = [np.zeros((0, 2), dtype=np.int64)]
    for each in np.unique(classes).tolist():
        alike = np.flatnonzero(classes == each)
        near = cKDTree(positions[alike, :2]).query_pairs(reach_m, output_type="ndarray")
        found.append(alike[np.sort(near, axis=1)])
    return np.concatenate(found)


def fuse_across_drives(object_map: ObjectMap, graph: FactorGraph, drives: IntArray, *, radius_m: float) -> int:
    """Merge duplicate landmarks of many drives until there are none; returns how many were merged into another.

    Two landmarks are duplicates if they have the same class, are mutual nearest neighbours of that class within
    ``radius_m`` in the plane, and no keyframe, or only those of the fewer drives that passed, observed both. The
    older one stays where it is and is compared again, with the keyframes of both.

    Args:
        object_map: the landmarks.
        graph: their positions, at its current estimate.
        drives: (K,) number of the drive of each keyframe, by date.
        radius_m: largest horizontal distance of duplicates [m].
    """
    merged = 0
    while True:
        observers = graph.observers()
        rows = np.intersect1d(object_map.in_state(LandmarkState.CONFIRMED), graph.landmarks)
        nearest = _nearest_alike(graph.landmark_positions(rows), object_map.labels.classes(rows), radius_m)
        before = merged
        for index, other in enumerate(nearest.tolist()):
            kept, dropped = rows[[index, other]].tolist()
            is_mutual = index < other and nearest[other] == index
            if is_mutual and _may_be_one(observers[kept], observers[dropped], drives):
                object_map.merge(kept, dropped)
                merged += 1
        if merged == before:
            return merged
        graph.alias_landmarks(object_map.aliases)


def _may_be_one(a: set[int], b: set[int], drives: IntArray) -> bool:
    """Whether no keyframe observed both landmarks, or most drives that passed have one of them rather than both.

    Only drives from the one before the first that has the rarer landmark to the one after the last count: an object
    that came later than the one beside it was not there for the others to see.
    """
    if a.isdisjoint(b):
        return True
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
