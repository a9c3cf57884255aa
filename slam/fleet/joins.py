"""Places of one map recognised in earlier ones: retrieved, registered, and weighed by a likelihood ratio.

The maps stand side by side in one index, so the time of a query does not grow with their number.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from descriptors.descriptellation_lr.pair_index import PairIndex
from descriptors.registry import shipped_likelihood
from logs.storage.placement import write_text
from slam.common.arrays import FloatArray, IntArray
from slam.common.config import Config
from slam.common.geometry import apply, invert
from slam.fleet.condensed_map import place_landmarks
from slam.fleet.session_config import session_config
from slam.loop_closure.consistency import poses_agree, shared_covariance
from slam.loop_closure.likelihood_ratio import COVERAGE_RANGES, compute_log_likelihood_ratio
from slam.loop_closure.verification import register
from slam.object_map.map_io import SavedMap
from slam.object_map.submap import Submap
from slam.place_recognition.place_search import PlaceSearch
from slam.registration.parameters import registration_config

MIN_LLR = 10.0
"""Rarely reached by chance at one place [nats]."""
MAPS_PER_PLACE = 8
"""Poses of a place that are verified: where many maps overlap, a few of them suffice to join it to all."""


@dataclass(frozen=True, slots=True, eq=False)
class Join:
    """A place of map ``query_map`` recognised in the earlier map ``reference_map``.

    ``T_query_place``, ``T_reference_place`` (4, 4): the place in the frames of the two maps, the latter with its
    ``covariance`` (6, 6), rotation first; ``llr``: log-likelihood ratio of the same place against chance [nats];
    ``pairs`` (P, 2): rows of the landmarks of the two maps that were matched.
    """

    query_map: int
    reference_map: int
    place: int
    T_query_place: FloatArray
    T_reference_place: FloatArray
    covariance: FloatArray
    llr: float
    pairs: IntArray

    @property
    def T_reference_query(self) -> FloatArray:
        """The transform (4, 4) between the two maps that it implies."""
        return self.T_reference_place @ invert(self.T_query_place)


def write_joins(path: Path, joins: Sequence[Join]) -> None:
    """Write joins as JSON.

    Raises:
        UnwritableLogError: the file cannot be written.
    """
    write_text(path, json.dumps([asdict(join) for join in joins], default=np.ndarray.tolist))


def read_joins(path: Path) -> list[Join]:
    """The joins that :func:`write_joins` wrote."""
    values: list[dict[str, Any]] = json.loads(path.read_text(encoding="utf-8"))
    arrays = "T_query_place", "T_reference_place", "covariance", "pairs"
    return [Join(**{**each, **{name: np.array(each[name]) for name in arrays}}) for each in values]


class PlaceIndex:
    """The landmarks of condensed maps, numbered in their order, side by side along x.

    ``sigma_m``: how far a landmark of one map and the same of another are apart, in each coordinate.
    """

    def __init__(self, maps: Sequence[SavedMap], *, sigma_m: float) -> None:
        self._maps, self._sigma_m = maps, sigma_m
        positions = [saved.objects.positions for saved in maps]
        counts = [len(each) for each in positions]
        self._pitch_m = 1.5 * max(float(np.ptp(each[:, :2], axis=0).max()) for each in positions) + 1e3 * sigma_m
        lows_m = np.array([each[:, 0].min() for each in positions])
        self._x_m = self._pitch_m * (np.arange(len(maps)) + 0.25) - lows_m
        labels = [label for saved in maps for label in saved.objects.labels]
        self._vocabulary = pd.Index(sorted(set(labels)))
        classes = self._vocabulary.get_indexer(pd.Index(labels))
        self._classes = np.split(classes, np.cumsum(counts)[:-1])
        frequencies = 1.0 + np.bincount(classes)
        self._class_shares = frequencies / frequencies.sum()
        side_by_side = np.concatenate(positions)
        side_by_side[:, 0] += np.repeat(self._x_m, counts)
        pairs = PairIndex(shipped_likelihood())
        pairs.add(side_by_side, classes)
        self._search = PlaceSearch(pairs, side_by_side, classes, len(self._vocabulary))

    def find_joins(self, query_map: SavedMap) -> list[Join]:
        """Where places of the next map are in those of the index, with log-likelihood ratios of at least ``MIN_LLR``.

        All of them together decide which are right (:mod:`slam.fleet.acceptance`).

        Raises:
            SavedMapError: the configuration of the map cannot be read.
        """
        config = session_config(query_map.metadata)
        joins = list[Join]()
        for place in range(len(query_map.graph.keyframe_ids)):
            found = list[Join]()
            for join in self._find_place(query_map, place, config):
                # Poses from which registration began may lead to the same one.
                if join.llr >= MIN_LLR and not any(_are_same(join, other, config) for other in found):
                    found.append(join)
            joins += found
        return joins

    def _find_place(self, query_map: SavedMap, place: int, config: Config) -> Iterator[Join]:
        """The place of a map at the likeliest poses that can be registered."""
        query = self._query(query_map, place, config)
        registering = registration_config(config)
        if len(query) < registering.min_inliers:
            return
        reach_m = float(np.hypot(*query.positions[:, :2].T).max()) + COVERAGE_RANGES * config.sensor_range_m
        for number, T_map_place in self._poses(query):
            reference = self._reference(number, T_map_place[:3, 3], reach_m)
            registration = register(query, reference, T_map_place, registering)
            T, covariance, pairs = registration.T_reference_query, registration.covariance, registration.pairs
            if T is None or covariance is None or len(pairs) < registering.min_inliers:
                continue
            ratio = compute_log_likelihood_ratio(query, reference, T, pairs, config.sensor_range_m, self._class_shares)
            yield Join(
                query_map=len(self._maps),
                reference_map=number,
                place=place,
                T_query_place=query_map.graph.T_map_body[place],
                T_reference_place=T,
                covariance=covariance + shared_covariance(config.calibration.objects),
                llr=ratio.total,
                pairs=np.column_stack([query.rows[pairs[:, 0]], reference.rows[pairs[:, 1]]]),
            )

    def _poses(self, query: Submap) -> Iterator[tuple[int, FloatArray]]:
        """The likeliest poses (4, 4) of a query, each with the number of the map that it is in."""
        poses = self._search.find_poses(query, map_sigma_m=self._sigma_m, count=MAPS_PER_PLACE)
        middle = query.positions.mean(axis=0, keepdims=True)
        for T in poses:
            number = int(apply(T, middle)[0, 0] // self._pitch_m)
            if 0 <= number < len(self._maps):
                T_map_query = T.copy()
                T_map_query[0, 3] -= self._x_m[number]
                yield number, T_map_query

    def _query(self, query_map: SavedMap, place: int, config: Config) -> Submap:
        """The landmarks around a place, in its frame; only classes that the index has."""
        rows = place_landmarks(query_map, place)
        labels = self._vocabulary.get_indexer(pd.Index(query_map.objects.labels).take(rows))
        rows, labels = rows[labels >= 0], labels[labels >= 0]
        positions = apply(invert(query_map.graph.T_map_body[place]), query_map.objects.positions[rows])
        objects = config.calibration.objects
        distances_m = np.hypot(positions[:, 0], positions[:, 1])
        sigmas = np.hypot(objects.landmark_sigma_m, objects.landmark_sigma_per_m * distances_m)
        return Submap(positions, sigmas, labels, rows, local_sigma_m=objects.landmark_sigma_m)

    def _reference(self, number: int, centre: FloatArray, radius_m: float) -> Submap:
        """The landmarks of a map within a radius of a point (3,) of it, in its frame."""
        positions = self._maps[number].objects.positions
        rows = np.flatnonzero(np.hypot(*(positions[:, :2] - centre[:2]).T) <= radius_m)
        return Submap(positions[rows], np.full(len(rows), self._sigma_m), self._classes[number][rows], rows)


def _are_same(join: Join, other: Join, config: Config) -> bool:
    return join.reference_map == other.reference_map and poses_agree(
        join.T_reference_place, other.T_reference_place, sensor_range_m=config.sensor_range_m
    )
