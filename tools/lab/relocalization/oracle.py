"""What could be known of a kidnapped robot's place: all poses, all observations of a drive, and their true noise.

It is given which detections are of one object, by their true ids, and how the robot moved; then every pair of objects
votes with every pair of landmarks of the same classes. What it finds bounds what any relocalization can find.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pandas as pd
from scipy.special import logsumexp

from logs.messages import DetectionTruth, GroundTruthPose, ObjectDetections, Record
from slam.common.arrays import FloatArray
from slam.common.config import Config
from slam.common.geometry import apply, invert
from slam.localization.map_area import MapArea
from slam.localization.pose_prior import PosePrior
from slam.loop_closure.likelihood_ratio import compute_log_likelihood_ratio
from slam.object_map.submap import Submap, gravity_frame
from slam.registration.parameters import registration_config
from slam.registration.registration import register
from tools.lab.relocalization.known_map import KnownMap
from tools.lab.relocalization.trial import RECOVERED_WITHIN_M, Tolerance, deviation

MIN_OBJECTS = 2
POSES = 64
"""Poses that are compared."""


class Oracle:
    """Searches one map that was driven; answers are right within a tolerance."""

    def __init__(self, known: KnownMap, config: Config, tolerance: Tolerance) -> None:
        objects = known.driven.objects
        labels = objects.class_probabilities.argmax(axis=1).astype(np.int64)
        sigmas = np.full(len(labels), config.calibration.objects.landmark_sigma_m)
        self._known, self._config, self._tolerance = known, config, tolerance
        self._registration = registration_config(config).model_copy(update={"min_inliers": MIN_OBJECTS})
        self._vocabulary = {label: index for index, label in enumerate(objects.vocabulary)}
        self._map = Submap(objects.positions, sigmas, labels, np.arange(len(labels)))
        counts = 1.0 + np.bincount(labels, minlength=len(objects.vocabulary))
        self._shares = counts / counts.sum()
        cells = MapArea(cell_m=config.sensor_range_m * 2.0 / 3.0)
        cells.cover_positions(known.driven.graph.T_map_body[:, :2, 3])
        self._area_m2 = cells.area_m2

    def finds(self, records: Iterable[Record]) -> bool:
        """Whether the likeliest place after the first 40 m of a drive is right, and sure enough to be accepted.

        Args:
            records: as simulated, in the order of time.
        """
        query, T_world_gravity = self._observe(records)
        if len(query) < MIN_OBJECTS:
            return False
        found = register(
            query.positions,
            self._map.positions,
            np.argwhere(query.labels[:, None] == self._map.labels),
            self._registration,
            query_sigmas=query.sigmas,
            reference_sigmas=self._map.sigmas,
            count=POSES,
        )
        prior = PosePrior(np.eye(4), np.inf, np.inf, 0.5, self._area_m2)
        log_odds, poses = [0.0], list[FloatArray | None]([None])  # somewhere else
        for each in found:
            if each.T_reference_query is not None and each.covariance is not None:
                ratio = compute_log_likelihood_ratio(
                    query, self._map, each.T_reference_query, each.pairs, self._config.sensor_range_m, self._shares
                )
                log_odds.append(prior.log_mass(each.T_reference_query, each.covariance) + ratio.total)
                poses.append(each.T_reference_query)
        T_map_query = poses[int(np.argmax(log_odds))]
        probability = np.exp(max(log_odds) - logsumexp(log_odds))
        if T_map_query is None or probability < 1.0 - self._config.localization.error_probability:
            return False
        T_world_query = self._known.to_world_nearby(T_map_query, T_world_gravity)
        return self._tolerance.allows(deviation(T_world_query, T_world_gravity))

    def _observe(self, records: Iterable[Record]) -> tuple[Submap, FloatArray]:
        """The objects seen of classes of the map, in the gravity frame of the last pose, and that pose (4, 4)."""
        seen, T_world_gravity = _objects_seen(records, RECOVERED_WITHIN_M)
        known = [each for each in seen if each[2] in self._vocabulary]
        positions = np.array([position for position, _, _ in known]).reshape(-1, 3)
        sigmas = np.hypot([sigma for _, sigma, _ in known], self._config.calibration.objects.landmark_sigma_m)
        labels = np.array([self._vocabulary[label] for _, _, label in known], dtype=np.int64)
        return Submap(apply(invert(T_world_gravity), positions), sigmas, labels, np.arange(len(known))), T_world_gravity


def _objects_seen(records: Iterable[Record], length_m: float) -> tuple[list[tuple[FloatArray, float, str]], FloatArray]:
    """Of each true object the weighted mean position (3,) m in the world, its standard deviation [m] and the commonest
    label; and the gravity frame of the last pose (4, 4).
    """
    rows = list[dict[str, object]]()
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
            weights = 3.0 / np.trace(detections.covariances, axis1=1, axis2=2)
            moments = weights[:, None] * apply(T_world_body, detections.positions)
            rows += [
                {"object": name, "label": label, "weight": weight, **dict(zip("xyz", moment, strict=True))}
                for name, label, weight, moment in zip(
                    record.object_ids, detections.labels, weights, moments, strict=True
                )
                if name
            ]
    table = pd.DataFrame(rows, columns=["object", "label", "weight", "x", "y", "z"])
    seen = []
    for _, of_object in table.groupby("object", sort=False):
        weight = of_object["weight"].sum()
        mean = of_object[["x", "y", "z"]].sum().to_numpy(dtype=np.float64) / weight
        seen.append((mean, float(weight**-0.5), str(of_object["label"].mode()[0])))
    return seen, gravity_frame(T_world_body)
