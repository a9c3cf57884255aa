"""Places of one map recognised in others: retrieved by quads, registered, and weighed by a likelihood ratio."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam.backend.factors import EdgeKind
from slam.common.arrays import FloatArray
from slam.common.config import Config
from slam.loop_closure.consistency import poses_agree, shared_covariance
from slam.loop_closure.likelihood_ratio import COVERAGE_RANGES, compute_log_likelihood_ratio
from slam.map_joining.condensed_map import place_submap_rows, positions_from
from slam.map_joining.place_index import PlaceIndex
from slam.object_map.map_io import SavedMap, are_of_kind
from slam.object_map.submap import Submap
from slam.registration.parameters import registration_config
from slam.registration.registration import refine

MIN_LLR = 10.0
"""Rarely reached by chance at one place [nats]."""
MAPS_PER_PLACE = 8
"""Poses of a place that are verified: where many maps overlap, a few of them suffice to join it to all."""


@dataclass(frozen=True, slots=True, eq=False)
class Join:
    """A place of map ``query_map`` recognised in map ``reference_map``.

    ``T_reference_place`` (4, 4): the place in the frame of the other map, with its covariance (6, 6), rotation first;
    ``llr``: log-likelihood ratio of the same place against chance [nats]; ``matched``: objects; ``pairs``: ids of the
    landmarks of the two maps that were matched.
    """

    query_map: int
    place: int
    reference_map: int
    T_reference_place: FloatArray
    covariance: FloatArray
    llr: float
    matched: int
    pairs: tuple[tuple[str, str], ...] = ()


def find_joins(query: SavedMap, number: int, index: PlaceIndex, config: Config) -> list[Join]:
    """Where places of a condensed map, which has a ``number`` in the index, are in the maps before it.

    Those with a log-likelihood ratio of at least ``MIN_LLR`` are returned; all of them together decide which are right
    (:mod:`slam.map_joining.acceptance`).
    """
    joins = []
    shares, registering = index.objects.class_shares(), registration_config(config)
    for place in range(len(query.graph.keyframe_ids)):
        submap = _query_submap(query, place, index, config)
        if len(submap) < registering.min_inliers:
            continue
        known: list[Join] = []
        for found in index.find(submap, count=MAPS_PER_PLACE, before=number):
            reach_m = float(np.hypot(*submap.positions[:, :2].T).max()) + COVERAGE_RANGES * config.sensor_range_m
            reference = index.submap(found.map_number, found.T_map_query[:3, 3], reach_m, sigma_m=index.objects.sigma_m)
            registration = refine(
                submap.positions,
                submap.labels,
                reference.positions,
                reference.labels,
                found.T_map_query,
                registering,
                query_sigmas=submap.sigmas,
                reference_sigmas=reference.sigmas,
            )
            T, covariance = registration.T_reference_query, registration.covariance
            if T is None or covariance is None or len(registration.pairs) < registering.min_inliers:
                continue
            ratio = compute_log_likelihood_ratio(
                submap, reference, T, registration.pairs, config.sensor_range_m, shares
            )
            join = Join(
                number,
                place,
                found.map_number,
                T,
                covariance + shared_covariance(config.calibration.objects),
                ratio.total,
                ratio.matched_count,
                tuple(
                    (query.objects.ids[submap.rows[own]], index.name_of(reference.rows[other]))
                    for own, other in registration.pairs.tolist()
                ),
            )
            if ratio.total >= MIN_LLR and not _is_known(join, known, config):
                known.append(join)
        joins += known
    return joins


def _is_known(join: Join, known: list[Join], config: Config) -> bool:
    """Whether another pose from which the registration began has led to the same one."""
    return any(
        join.reference_map == other.reference_map
        and poses_agree(join.T_reference_place, other.T_reference_place, sensor_range_m=config.sensor_range_m)
        for other in known
    )


def _query_submap(query: SavedMap, place: int, index: PlaceIndex, config: Config) -> Submap:
    """The landmarks around a place, in its frame; only classes that the index has."""
    objects = config.calibration.objects
    rows = place_submap_rows(query, place)
    positions = positions_from(query, place, rows)
    distances_m = np.hypot(positions[:, 0], positions[:, 1])
    sigmas = np.hypot(objects.landmark_sigma_m, objects.landmark_sigma_per_m * distances_m)
    names = query.objects.labels
    labels = index.labels_of([names[row] for row in rows.tolist()])
    submap = Submap(positions, sigmas, labels, rows)
    return submap.of(np.flatnonzero(labels >= 0))


def mean_drift(condensed: SavedMap) -> tuple[float, float]:
    """Variances of the odometry on a metre of the drive: of the position [m^2 / m] and of the heading [rad^2 / m]."""
    graph = condensed.graph
    is_driven = are_of_kind(graph, EdgeKind.ODOMETRY)
    travel_m = float(np.linalg.norm(graph.edge_transforms[is_driven, :3, 3], axis=1).sum())
    covariances = graph.edge_covariances[is_driven]
    if travel_m == 0.0:
        return 0.0, 0.0
    return float(covariances[:, 4, 4].sum()) / travel_m, float(covariances[:, 2, 2].sum()) / travel_m
