"""Fusion of duplicate landmarks: one object that has several of them.

A closure associates the newest traversal with one earlier one. Where three traversals overlap, or two overlap for less
travel than lies between two closures, an object may have a landmark for each of them. So it may where the robot comes
back with a larger error than the odometry is expected to have.
"""

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
    # Those of one class, by distances along the ground.
    apart = np.column_stack([positions[:, :2], 2.0 * reach_m * classes])
    pairs = cKDTree(apart).query_pairs(reach_m, output_type="ndarray")
    d, pairs = np.subtract(*positions[pairs.T]), rows[pairs]
    unseen = missed * (1 - np.array([len(observers[a] & observers[b]) for a, b in pairs.tolist()]))
    # An offset errs by a landmark's noise across its direction, at least, and by its length along it, at the likeliest.
    noise_m = config.landmark_sigma_m
    most = unseen - log_density - np.log(2.0 * np.pi * noise_m * np.maximum(np.hypot(d[:, 0], d[:, 1]), noise_m))
    d, pairs, unseen = (each[most > LEAST_LOG_ODDS] for each in (d, pairs, unseen))
    if not len(pairs):
        return []
    try:
        covariances = graph.relative_covariances(pairs)
    except FactorGraphError as error:
        logger.info("duplicate landmarks are not merged: %s", error)
        return []
    height_m = np.hypot(noise_m, config.landmark_height_sigma_m)
    S = covariances + np.diag([noise_m, noise_m, height_m]) ** 2
    tail = (FREEDOM + 3.0) * np.log1p(squared_mahalanobis(d, S) / FREEDOM)
    log_area = np.log((2.0 * np.pi) ** 2 * np.linalg.det(S[:, :2, :2]))
    ratios = -0.5 * (tail + log_area) - log_density + unseen
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
