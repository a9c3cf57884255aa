"""What could be known of a kidnapped robot's place: all poses, all observations of a drive, and their true noise.

It is given which detections are of one object, by their true ids, and how the robot moved; then every pair of objects
is tried against every pair of landmarks of the map. What it finds bounds what any relocalization can find.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from logs.messages import DetectionTruth, GroundTruthPose, ObjectDetections, Record
from slam.common.arrays import FloatArray
from slam.common.config import Config
from slam.common.geometry import apply, invert
from slam.localization.map_area import MapArea
from slam.localization.pose_prior import PosePrior
from slam.loop_closure.consistency import poses_agree
from slam.loop_closure.likelihood_ratio import compute_log_likelihood_ratio
from slam.object_map.submap import Submap, gravity_frame
from slam.registration.parameters import registration_config
from slam.registration.registration import Registration
from tools.lab.relocalization.exhaustive_search import make_exhaustive_search
from tools.lab.relocalization.figures import Tolerance, deviation
from tools.lab.relocalization.known_map import KnownMap

REACH_M = 80.0
"""Longest pairs of objects: what is seen on 40 m of travel with a range of 30 m is mostly nearer together."""
MIN_OBJECTS = 2


@dataclass(frozen=True, slots=True)
class OracleAnswer:
    """``probability`` of the likeliest pose, None if there is none, and whether that ``is_right``."""

    probability: float | None
    is_right: bool

    def finds(self, error_probability: float) -> bool:
        """Whether the place is known so surely, and right."""
        return self.is_right and self.probability is not None and self.probability >= 1.0 - error_probability


class Oracle:
    """Searches one map."""

    def __init__(self, known: KnownMap, config: Config) -> None:
        saved = known.driven
        objects = saved.objects
        labels = objects.class_probabilities.argmax(axis=1).astype(np.int64)
        rows = np.arange(len(labels))
        sigmas = np.full(len(labels), config.calibration.objects.landmark_sigma_m)
        self._known = known
        self._config = config
        self._registration = registration_config(config).model_copy(update={"min_inliers": MIN_OBJECTS})
        self._vocabulary = {label: index for index, label in enumerate(objects.vocabulary)}
        self._map = Submap(objects.positions, sigmas, labels, rows)
        counts = 1.0 + np.bincount(labels, minlength=len(objects.vocabulary))
        self._shares = counts / counts.sum()
        self._search = make_exhaustive_search(objects.positions, labels, sigmas, self._registration, reach_m=REACH_M)
        cells = MapArea(cell_m=config.sensor_range_m * 2.0 / 3.0)
        cells.cover_positions(saved.graph.T_map_body[:, :2, 3])
        self._area_m2 = cells.area_m2

    def answer(self, records: Iterable[Record], length_m: float, tolerance: Tolerance) -> OracleAnswer:
        """Where the robot is after ``length_m`` of a drive, given as simulated records in the order of time."""
        seen, T_world_gravity = _objects_seen(records, length_m, self._config)
        query = self._query(seen, T_world_gravity)
        if len(query) < MIN_OBJECTS:
            return OracleAnswer(None, is_right=False)
        found = self._distinct(self._search.localize(query.positions, query.labels, sigmas=query.sigmas))
        if not found:
            return OracleAnswer(None, is_right=False)
        prior = PosePrior(np.eye(4), np.inf, np.inf, 0.5, self._area_m2)
        log_odds = [
            prior.log_mass(each.T_reference_query, each.covariance)
            + compute_log_likelihood_ratio(
                query, self._map, each.T_reference_query, each.pairs, self._config.sensor_range_m, self._shares
            ).total
            for each in found
            if each.T_reference_query is not None and each.covariance is not None
        ]
        best = int(np.argmax(log_odds))
        T_map_query = found[best].T_reference_query
        assert T_map_query is not None
        errors = deviation(self._known.to_world_nearby(T_map_query, T_world_gravity), T_world_gravity)
        probability = float(np.exp(log_odds[best] - logsumexp([0.0, *log_odds])))
        return OracleAnswer(probability, is_right=tolerance.allows(*errors))

    def _distinct(self, found: list[Registration]) -> list[Registration]:
        """Those of the poses, best first, that no better one agrees with."""
        kept = dict[int, FloatArray]()
        for index, each in enumerate(found):
            T = each.T_reference_query
            if T is not None and not any(
                poses_agree(T, other, sensor_range_m=self._config.sensor_range_m) for other in kept.values()
            ):
                kept[index] = T
        return [found[index] for index in kept]

    def _query(self, seen: dict[str, tuple[FloatArray, float, str]], T_world_gravity: FloatArray) -> Submap:
        """The objects seen, in the gravity frame of the last pose; those of classes that the map has."""
        known = [each for each in seen.values() if each[2] in self._vocabulary]
        positions = np.array([position for position, _, _ in known]).reshape(-1, 3)
        return Submap(
            apply(invert(T_world_gravity), positions),
            np.hypot([sigma for _, sigma, _ in known], self._config.calibration.objects.landmark_sigma_m),
            np.array([self._vocabulary[label] for _, _, label in known], dtype=np.int64),
            np.arange(len(known)),
        )


def _objects_seen(
    records: Iterable[Record], length_m: float, config: Config
) -> tuple[dict[str, tuple[FloatArray, float, str]], FloatArray]:
    """Mean position (3,) m in the world, its standard deviation [m] and the commonest label of each true object."""
    sums: dict[str, list[tuple[FloatArray, float, str]]] = defaultdict(list)
    detections: ObjectDetections | None = None
    T_world_body, travel_m = np.eye(4), -1.0
    for record in records:
        if isinstance(record, ObjectDetections):
            detections = record
        elif isinstance(record, GroundTruthPose):
            step_m = float(np.linalg.norm(record.T_world_body[:3, 3] - T_world_body[:3, 3])) if travel_m >= 0.0 else 0.0
            travel_m = max(travel_m, 0.0) + step_m
            if travel_m > length_m:
                break
            T_world_body = record.T_world_body
        elif isinstance(record, DetectionTruth) and detections is not None and detections.covariances is not None:
            placed = apply(T_world_body, detections.positions)
            variances = np.trace(detections.covariances, axis1=1, axis2=2) / 3.0
            for index, name in enumerate(record.object_ids):
                if name:
                    sums[name].append((placed[index], float(variances[index]), detections.labels[index]))
    seen = {}
    for name, values in sums.items():
        weights = np.array([1.0 / variance for _, variance, _ in values])
        mean = np.average([position for position, _, _ in values], axis=0, weights=weights)
        labels = [label for _, _, label in values]
        seen[name] = (mean, float(weights.sum() ** -0.5), max(sorted(set(labels)), key=labels.count))
    return seen, gravity_frame(T_world_body)
