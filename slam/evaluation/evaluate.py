"""From the records of a log to an evaluation."""

from __future__ import annotations

import numpy as np

from logs.closures import find_final_decisions
from logs.messages import ObjectMapRecord
from slam.common.arrays import FloatArray
from slam.common.errors import EvaluationError
from slam.evaluation.inputs.protocol import Protocol
from slam.evaluation.inputs.records import EvaluationRecords
from slam.evaluation.inputs.synchronization import PoseSeries, clean_poses
from slam.evaluation.metrics.association import AssociationQuality, evaluate_associations, label_detections
from slam.evaluation.metrics.calibration import CalibrationQuality
from slam.evaluation.metrics.consistency_tests import evaluate_calibration
from slam.evaluation.metrics.landmarks import (
    CONFIRMED,
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

NO_KEYFRAMES = "no keyframes in the log (/slam/graph), so revisits are unknown"
NO_STATUS = "no status in the log (/slam/status)"
NO_RUN_TIME = (
    "logs hold no times of the machine that made them, so that they are the same on every one; "
    "'dslam replay --json' and 'dslam benchmark replay' tell them"
)
NO_TRUTH = "no ground truth: pass --reference LOG.mcap or record /ground_truth"
IN_GIVEN_MAP = "closures go to the keyframes of a given map, of which this log holds no truth: see relocalization"


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


class _Evaluator:
    def __init__(self, records: EvaluationRecords, protocol: Protocol, map_alignment: FloatArray | None) -> None:
        self._records = records
        self._protocol = protocol
        self._map_alignment = map_alignment
        self._unavailable: dict[str, str] = {}
        self._truth = _series([(r.stamp_ns, r.T_world_body) for r in records.true_poses])
        closure_poses = records.closure_true_poses
        self._closure_truth = (
            _series([(r.stamp_ns, r.T_world_body) for r in closure_poses]) if closure_poses else self._truth
        )
        self._odometry = _series([(r.stamp_ns, r.T_odom_body) for r in records.odometry])

    def run(self) -> Evaluation:
        records = self._records
        final = records.trajectory
        final_poses = clean_poses(final.stamps_ns, final.T_map_body) if final else _series([])
        no_estimate = "no final trajectory (/slam/trajectory_stamped): was the run finished?"
        estimate = self._trajectory("trajectory", final_poses, no_estimate)
        by_closure_reference = None
        if self._closure_truth is not self._truth:
            by_closure_reference = self._trajectory(
                "closure_reference", final_poses, no_estimate, truth=self._closure_truth
            )
        odometry = self._trajectory(
            "odometry",
            self._odometry,
            "no odometry in the log, or several topics of it: choose one with --topic odometry=/topic",
        )
        online = self._trajectory(
            "online", _series([(r.stamp_ns, r.T_map_body) for r in records.online_poses]), "no /slam/pose in the log"
        )
        associations = self._associations()
        best = estimate or online
        T_world_map = best.alignment.T_world_map if best else None
        landmarks = self._landmarks(associations, T_world_map)
        closures = self._closures()
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
            landmarks=landmarks,
            closures=closures,
            retrieval=self._retrieval(closures),
            pairs=pairs,
            online_queries=online_queries,
            relocalization=self._relocalization(T_world_map),
            calibration=self._calibration(associations, closures),
            counters=dict(records.status.counters) if records.status else {},
            unavailable=self._unavailable,
        )

    def _trajectory(
        self, part: str, estimate: PoseSeries, absent: str, *, truth: PoseSeries | None = None
    ) -> TrajectoryErrors | None:
        truth = self._truth if truth is None else truth
        if len(estimate.stamps_ns) == 0 or len(truth.stamps_ns) == 0:
            self._unavailable[part] = absent if len(estimate.stamps_ns) == 0 else NO_TRUTH
            return None
        try:
            return evaluate_trajectory(
                estimate,
                truth,
                max_gap_s=self._protocol.max_truth_gap_s,
                lengths_m=self._protocol.relative_lengths_m,
                short_lengths_m=self._protocol.short_relative_lengths_m,
                start_step=self._protocol.relative_start_step,
            )
        except EvaluationError as error:
            self._unavailable[part] = str(error)
            return None

    def _associations(self) -> AssociationQuality | None:
        records = self._records
        path = next((p for p in (self._odometry, self._truth) if len(p.stamps_ns)), None)
        if not records.associations or not records.detection_truths or path is None:
            if not records.associations:
                reason = "no associations in the log (/slam/associations)"
            elif not records.detection_truths:
                reason = "no truth of the detections: pass --reference LOG.mcap or record /ground_truth/detections"
            else:
                reason = "neither odometry nor ground truth, so travel between measurements is unknown"
            self._unavailable["associations"] = reason
            return None
        object_map = records.object_map
        confirmed = None
        if object_map:
            pairs = zip(object_map.ids, object_map.states, strict=True)
            confirmed = [name for name, state in pairs if state == CONFIRMED]
        try:
            detections = label_detections(
                records.associations, records.detection_truths, path, aliases=find_aliases(object_map)
            )
        except EvaluationError as error:
            self._unavailable["associations"] = str(error)
            return None
        if detections.frame_count == 0:
            self._unavailable["associations"] = (
                f"none of {len(records.associations)} frames has the stamp of a truth: is the reference of this drive?"
            )
            return None
        return evaluate_associations(detections, revisit_m=self._protocol.revisit_m, confirmed_landmark_ids=confirmed)

    def _landmarks(
        self, associations: AssociationQuality | None, T_world_map: FloatArray | None
    ) -> LandmarkQuality | None:
        map_est, map_gt = self._records.object_map, self._records.true_objects
        if map_est is None or map_gt is None:
            self._unavailable["landmarks"] = (
                "no object map in the log (/slam/map)"
                if map_est is None
                else "no true objects: pass --reference LOG.mcap or record /ground_truth/objects"
            )
            return None
        protocol = self._protocol
        if associations is not None:
            matches = match_by_detections(
                map_est, map_gt, associations.landmark_object_ids, has_prior_map=self._records.has_prior_map
            )
        elif T_world_map is not None:
            matches = match_by_position(map_est, map_gt, T_world_map, max_distance_m=protocol.match_distance_m)
        else:
            self._unavailable["landmarks"] = "neither a truth of the detections nor an aligned trajectory to match with"
            return None
        try:
            return evaluate_landmarks(
                map_est,
                map_gt,
                matches,
                path_gt=self._truth,
                T_world_map=T_world_map,
                object_detection_counts=associations.object_detection_counts if associations else None,
                window_m=protocol.window_m,
                stride_m=protocol.window_stride_m,
                least_landmarks=protocol.window_least_landmarks,
                least_detections=protocol.least_detections,
            )
        except EvaluationError as error:
            self._unavailable["landmarks"] = str(error)
            return None

    def _closures(self) -> ClosureQuality | None:
        graph, candidates = self._records.graph, self._records.closures
        no_rows = np.zeros(0, dtype=np.int64)
        if not candidates and (graph is None or len(self._closure_truth.stamps_ns) == 0):
            self._unavailable["closures"] = "no loop-closure candidate in the log"
            return None
        if len(self._closure_truth.stamps_ns) == 0:
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
        try:
            return evaluate_retrieval(
                self._records.closures,
                closures.revisits.revisits,
                dict(zip(graph.keyframe_ids.tolist(), graph.keyframe_stamps_ns.tolist(), strict=True)),
                self._closure_truth,
                self._protocol,
                place_count=self._records.verified_places,
            )
        except EvaluationError as error:
            self._unavailable["retrieval"] = str(error)
            return None

    def _literature_protocols(self) -> tuple[PairQuality, OnlineQuality] | tuple[None, None]:
        graph = self._records.graph
        if graph is None or len(self._closure_truth.stamps_ns) == 0:
            self._unavailable["literature_protocols"] = NO_KEYFRAMES if graph is None else NO_TRUTH
            return None, None
        candidates = find_final_decisions(self._records.closures)
        keyframes = compare_keyframes(candidates, graph, self._odometry.stamps_ns, self._closure_truth, self._protocol)
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
            reason = NO_TRUTH if len(self._truth.stamps_ns) == 0 else "no truth at their stamps"
            self._unavailable["relocalization"] = f"{quality.undecided_count} of {quality.fix_count} fixes: {reason}"
        return quality

    def _calibration(
        self, associations: AssociationQuality | None, closures: ClosureQuality | None
    ) -> CalibrationQuality | None:
        records = self._records
        matches = None
        if associations is not None and records.object_map is not None and records.true_objects is not None:
            matches = match_by_detections(
                records.object_map,
                records.true_objects,
                associations.landmark_object_ids,
                has_prior_map=records.has_prior_map,
            )
        quality, missing = evaluate_calibration(
            records.graph,
            records.object_map,
            records.true_objects,
            matches,
            closures.judged if closures is not None else None,
            self._truth,
            self._protocol,
        )
        if missing:
            self._unavailable["calibration"] = missing if len(self._truth.stamps_ns) else NO_TRUTH
        return quality


def find_aliases(object_map: ObjectMapRecord | None) -> dict[str, str]:
    """Id of each merged landmark -> id of the one that stands for it."""
    if object_map is None or not object_map.merged_into:
        return {}
    return {name: kept for name, kept in zip(object_map.ids, object_map.merged_into, strict=True) if kept}


def _series(stamped_poses: list[tuple[int, FloatArray]]) -> PoseSeries:
    stamps_ns = np.array([stamp for stamp, _ in stamped_poses], dtype=np.int64)
    return clean_poses(stamps_ns, np.array([T for _, T in stamped_poses], dtype=np.float64).reshape(-1, 4, 4))
