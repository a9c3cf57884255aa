"""From the records of a log to an evaluation."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np

from logs.closures import find_final_decisions
from logs.messages import ObjectMapRecord
from slam.common.arrays import FloatArray
from slam.common.errors import EvaluationError
from slam.evaluation.inputs.protocol import Protocol
from slam.evaluation.inputs.records import EvaluationRecords
from slam.evaluation.inputs.synchronization import PoseSeries, series_of
from slam.evaluation.metrics.association import AssociationQuality, evaluate_associations, label_detections
from slam.evaluation.metrics.calibration import CalibrationQuality, evaluate_calibration
from slam.evaluation.metrics.landmarks import (
    CONFIRMED,
    LandmarkMatches,
    LandmarkQuality,
    evaluate_landmarks,
    match_by_detections,
    match_by_position,
)
from slam.evaluation.metrics.relocalization import RelocalizationQuality, evaluate_relocalization
from slam.evaluation.metrics.trajectory import TrajectoryErrors, evaluate_trajectory
from slam.evaluation.place_recognition.closures import ClosureQuality, evaluate_closures
from slam.evaluation.place_recognition.place_pairs import (
    OnlineQuality,
    PairQuality,
    compare_keyframes,
    evaluate_online,
    evaluate_pairs,
)
from slam.evaluation.place_recognition.retrieval import RetrievalQuality, evaluate_retrieval
from slam.evaluation.result import Evaluation

NO_TRAJECTORY = "no final trajectory (/slam/trajectory_stamped): was the run finished?"
NO_ODOMETRY = "no odometry in the log, or several topics of it: choose one with --topic odometry=/topic"
NO_KEYFRAMES = "no keyframes in the log (/slam/graph), so revisits are unknown"
NO_STATUS = "no status in the log (/slam/status)"
NO_RUN_TIME = (
    "logs hold no times of the machine that made them, so that they are the same on every one; "
    "'dslam replay --json' and 'dslam benchmark replay' print them"
)
NO_TRUTH = "no ground truth: pass --reference LOG.mcap or record /ground_truth"
NO_DETECTION_TRUTH = "no truth of the detections: pass --reference LOG.mcap or record /ground_truth/detections"
NO_MAP = "no object map in the log (/slam/map)"
NO_TRUE_OBJECTS = "no true objects: pass --reference LOG.mcap or record /ground_truth/objects"
IN_GIVEN_MAP = "closures go to the keyframes of a given map, of which this log holds no truth: see relocalization"

_Quality = TypeVar("_Quality")


def evaluate(
    records: EvaluationRecords, protocol: Protocol | None = None, *, map_alignment: FloatArray | None = None
) -> Evaluation:
    """Measure all that the records allow; what they do not allow is absent, with its reason in ``unavailable``.

    Args:
        records: of the log.
        protocol: the thresholds; those of papers if None, with lengths in proportion to the sensor range of the run.
        map_alignment: ``T_world_map`` (4, 4) of the map that the robot was to find itself in, as
            :func:`slam.evaluation.metrics.relocalization.locate_map` finds it. It is used for the errors of
            relocalizations alone.

    Raises:
        EvaluationError: a pose is not finite.
    """
    return _Evaluator(records, protocol or protocol_of(records), map_alignment).run()


def protocol_of(records: EvaluationRecords) -> Protocol:
    """The protocol with lengths in proportion to the sensor range that the run went by."""
    range_m = records.sensor_range_m
    return Protocol() if range_m is None else Protocol().for_range(range_m)


def find_aliases(object_map: ObjectMapRecord | None) -> dict[str, str]:
    """Id of each merged landmark -> id of the one that stands for it."""
    if object_map is None or not object_map.merged_into:
        return {}
    return {name: kept for name, kept in zip(object_map.ids, object_map.merged_into, strict=True) if kept}


class _Evaluator:
    def __init__(self, records: EvaluationRecords, protocol: Protocol, map_alignment: FloatArray | None) -> None:
        self._records = records
        self._protocol = protocol
        self._map_alignment = map_alignment
        self._unavailable: dict[str, str] = {}
        self._truth = records.true_path
        closure_poses = records.closure_true_poses
        self._closure_truth = (
            series_of((r.stamp_ns, r.T_world_body) for r in closure_poses) if closure_poses else self._truth
        )
        self._odometry = records.odometry_path

    def run(self) -> Evaluation:
        records, final = self._records, self._records.final_path
        estimate = self._trajectory("trajectory", final, self._truth, NO_TRAJECTORY)
        by_closure_reference = None
        if self._closure_truth is not self._truth:
            by_closure_reference = self._trajectory("closure_reference", final, self._closure_truth, NO_TRAJECTORY)
        odometry = self._trajectory("odometry", self._odometry, self._truth, NO_ODOMETRY)
        online = self._trajectory("online", records.online_path, self._truth, "no /slam/pose in the log")
        best = estimate or online
        T_world_map = best.alignment.T_world_map if best else None
        associations, closures = self._associations(), self._closures()
        pairs, online_queries = self._literature_protocols()
        if records.status is None:
            self._unavailable["counters"] = NO_STATUS
        self._unavailable["run_time"] = NO_RUN_TIME
        return Evaluation(
            protocol=self._protocol,
            estimate=estimate,
            odometry=odometry,
            online=online,
            by_closure_reference=by_closure_reference,
            associations=associations,
            landmarks=self._landmarks(associations, T_world_map),
            closures=closures,
            retrieval=self._retrieval(closures),
            pairs=pairs,
            online_queries=online_queries,
            relocalization=self._relocalization(T_world_map),
            calibration=self._calibration(associations, closures),
            counters=dict(records.status.counters) if records.status else {},
            unavailable=self._unavailable,
        )

    def _measure(
        self, part: str, compute: Callable[[], _Quality], missing: dict[str, bool] | None = None
    ) -> _Quality | None:
        """What ``compute`` returns; None, with its reason noted, where something is ``missing`` or cannot be used."""
        reason = next((why for why, is_missing in (missing or {}).items() if is_missing), "")
        if not reason:
            try:
                return compute()
            except EvaluationError as error:
                reason = str(error)
        self._unavailable[part] = reason
        return None

    def _trajectory(
        self, part: str, estimate: PoseSeries, truth: PoseSeries, no_estimate: str
    ) -> TrajectoryErrors | None:
        protocol = self._protocol
        return self._measure(
            part,
            lambda: evaluate_trajectory(
                estimate,
                truth,
                max_gap_s=protocol.max_truth_gap_s,
                lengths_m=protocol.relative_lengths_m,
                short_lengths_m=protocol.short_relative_lengths_m,
                start_step=protocol.relative_start_step,
            ),
            {no_estimate: not len(estimate), NO_TRUTH: not len(truth)},
        )

    def _associations(self) -> AssociationQuality | None:
        records = self._records
        path = self._odometry if len(self._odometry) else self._truth
        missing = {
            "no associations in the log (/slam/associations)": not records.associations,
            NO_DETECTION_TRUTH: not records.detection_truths,
            "neither odometry nor ground truth, so travel between measurements is unknown": not len(path),
        }
        return self._measure("associations", lambda: self._compare_associations(path), missing)

    def _compare_associations(self, path: PoseSeries) -> AssociationQuality:
        records, object_map = self._records, self._records.object_map
        detections = label_detections(
            records.associations, records.detection_truths, path, aliases=find_aliases(object_map)
        )
        if detections.frame_count == 0:
            raise EvaluationError(
                f"none of {len(records.associations)} frames has the stamp of a truth: is the reference of this drive?"
            )
        confirmed = None
        if object_map:
            pairs = zip(object_map.ids, object_map.states, strict=True)
            confirmed = [name for name, state in pairs if state == CONFIRMED]
        return evaluate_associations(detections, revisit_m=self._protocol.revisit_m, confirmed_landmark_ids=confirmed)

    def _landmarks(
        self, associations: AssociationQuality | None, T_world_map: FloatArray | None
    ) -> LandmarkQuality | None:
        map_est, map_gt, protocol = self._records.object_map, self._records.true_objects, self._protocol
        if map_est is None or map_gt is None:
            self._unavailable["landmarks"] = NO_MAP if map_est is None else NO_TRUE_OBJECTS
            return None
        matches = self._matches(associations)
        if matches is None and T_world_map is not None:
            matches = match_by_position(map_est, map_gt, T_world_map, max_distance_m=protocol.match_distance_m)
        if matches is None:
            self._unavailable["landmarks"] = "neither a truth of the detections nor an aligned trajectory to match with"
            return None
        return self._measure(
            "landmarks",
            lambda: evaluate_landmarks(
                map_est,
                map_gt,
                matches,
                protocol,
                path_gt=self._truth,
                T_world_map=T_world_map,
                object_detection_counts=associations.object_detection_counts if associations else None,
            ),
        )

    def _matches(self, associations: AssociationQuality | None) -> LandmarkMatches | None:
        """Landmarks with their objects by the truth of the detections."""
        map_est, map_gt = self._records.object_map, self._records.true_objects
        if associations is None or map_est is None or map_gt is None:
            return None
        return match_by_detections(
            map_est, map_gt, associations.landmark_object_ids, has_prior_map=self._records.has_prior_map
        )

    def _closures(self) -> ClosureQuality | None:
        graph, candidates = self._records.graph, self._records.closures
        no_rows = np.zeros(0, dtype=np.int64)
        if not candidates and (graph is None or not len(self._closure_truth)):
            self._unavailable["closures"] = "no loop-closure candidate in the log"
            return None
        if not len(self._closure_truth):
            self._unavailable["closures"] = NO_TRUTH
        elif graph is None:
            self._unavailable["closures"] = NO_KEYFRAMES
        elif self._records.has_prior_map:
            self._unavailable["closures"] = IN_GIVEN_MAP
            graph = None
        return evaluate_closures(
            candidates,
            graph.keyframe_ids if graph else no_rows,
            graph.keyframe_stamps_ns if graph else no_rows,
            self._closure_truth,
            self._protocol,
        )

    def _retrieval(self, closures: ClosureQuality | None) -> RetrievalQuality | None:
        graph = self._records.graph
        if closures is None or closures.revisits is None or graph is None:
            self._unavailable["retrieval"] = self._unavailable["closures"]
            return None
        revisits = closures.revisits.revisits
        return self._measure(
            "retrieval",
            lambda: evaluate_retrieval(
                self._records.closures,
                revisits,
                dict(zip(graph.keyframe_ids.tolist(), graph.keyframe_stamps_ns.tolist(), strict=True)),
                self._closure_truth,
                self._protocol,
                place_count=self._records.verified_places,
            ),
        )

    def _literature_protocols(self) -> tuple[PairQuality, OnlineQuality] | tuple[None, None]:
        graph, truth = self._records.graph, self._closure_truth
        if graph is None or not len(truth):
            self._unavailable["literature_protocols"] = NO_KEYFRAMES if graph is None else NO_TRUTH
            return None, None
        candidates = find_final_decisions(self._records.closures)
        keyframes = compare_keyframes(candidates, graph, self._odometry.stamps_ns, truth, self._protocol)
        return evaluate_pairs(keyframes, self._protocol), evaluate_online(keyframes, self._protocol)

    def _relocalization(self, T_world_estimate: FloatArray | None) -> RelocalizationQuality | None:
        records = self._records
        if not records.statuses:
            self._unavailable["relocalization"] = NO_STATUS
            return None
        is_given = records.has_prior_map
        if self._map_alignment is not None and not is_given:
            self._unavailable["map_alignment"] = "not used: in this log the robot made its own map and was given none"
        is_located = is_given and self._map_alignment is not None
        quality = evaluate_relocalization(
            records,
            self._truth if is_given else self._closure_truth,
            self._odometry,
            self._protocol,
            T_world_map=self._map_alignment if is_located else T_world_estimate,
            method="map" if is_located else "trajectory" if is_given else "closure",
        )
        if quality.undecided_count:
            reason = "no truth at their stamps" if len(self._truth) else NO_TRUTH
            self._unavailable["relocalization"] = f"{quality.undecided_count} of {quality.fix_count} fixes: {reason}"
        return quality

    def _calibration(
        self, associations: AssociationQuality | None, closures: ClosureQuality | None
    ) -> CalibrationQuality | None:
        quality, missing = evaluate_calibration(
            self._records.graph,
            self._records.object_map,
            self._records.true_objects,
            self._matches(associations),
            closures.judged if closures is not None else None,
            self._truth,
            self._protocol,
        )
        if missing:
            self._unavailable["calibration"] = missing if len(self._truth) else NO_TRUTH
        return quality
