"""From the records of a log to an evaluation."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import numpy as np
import pandas as pd

from logs.closures import find_final_decisions
from logs.messages import ObjectMapRecord
from slam.common.arrays import FloatArray
from slam.common.errors import EvaluationError
from slam.evaluation.inputs.protocol import Protocol
from slam.evaluation.inputs.records import EvaluationRecords
from slam.evaluation.inputs.synchronization import PoseSeries, series_of
from slam.evaluation.metrics.association import (
    LabelledDetections,
    count_detections,
    evaluate_associations,
    identify_landmarks,
    label_detections,
)
from slam.evaluation.metrics.calibration import describe_calibration, evaluate_calibration
from slam.evaluation.metrics.landmarks import (
    CONFIRMED,
    LandmarkMatches,
    evaluate_landmarks,
    match_by_detections,
    match_by_position,
)
from slam.evaluation.metrics.relocalization import evaluate_relocalization
from slam.evaluation.metrics.trajectory import TrajectoryErrors, evaluate_trajectory
from slam.evaluation.place_recognition.closures import describe_closures, judge_closures
from slam.evaluation.place_recognition.revisits import describe_revisits, find_missed, find_revisits
from slam.evaluation.result import Evaluation, describe_trajectories, plain, undefined

NO_TRAJECTORY = "no final trajectory (/slam/trajectory_stamped): the run was not finished"
NO_ODOMETRY = "no odometry in the log, or several topics of it: choose one with --topic odometry=/topic"
NO_KEYFRAMES = "no keyframes in the log (/slam/graph), so revisits are unknown"
NO_STATUS = "no status in the log (/slam/status)"
NO_RUN_TIME = (
    "logs hold no times of the machine that made them, so that they do not depend on it; "
    "'dslam replay --json' prints them"
)
NO_TRUTH = "no ground truth: pass --reference LOG.mcap or record /ground_truth"
NO_DETECTION_TRUTH = "no truth of the detections: pass --reference LOG.mcap or record /ground_truth/detections"
NO_MAP = "no object map in the log (/slam/map)"
NO_TRUE_OBJECTS = "no true objects: pass --reference LOG.mcap or record /ground_truth/objects"
IN_GIVEN_MAP = "closures with keyframes of a given map have no truth in this log: see relocalization"
NO_MATCH = "neither a truth of the detections nor an aligned trajectory to match with"

_Measured = TypeVar("_Measured")


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
    """Measures part by part; a part that raises :class:`EvaluationError` is unavailable for this reason."""

    def __init__(self, records: EvaluationRecords, protocol: Protocol, map_alignment: FloatArray | None) -> None:
        self._records = records
        self._protocol = protocol
        self._map_alignment = map_alignment
        self._unavailable: dict[str, str] = {}
        self._truth = records.true_path
        self._odometry = records.odometry_path

    def run(self) -> Evaluation:
        records, protocol, nothing = self._records, self._protocol, _describe_nothing(self._protocol)
        estimate = self._trajectory("trajectory", records.final_path, NO_TRAJECTORY)
        odometry = self._trajectory("odometry", self._odometry, NO_ODOMETRY)
        online = self._trajectory("online", records.online_path, "no /slam/pose in the log")
        best = estimate or online
        T_world_map = best.alignment.T_world_map if best else None
        labelled = self._measure("associations", self._label_detections)
        matches = self._match_by_detections(labelled)
        landmarks = self._measure("landmarks", lambda: self._describe_landmarks(labelled, matches, T_world_map))
        judged, queries = self._judge_closures()
        consistency, missing = evaluate_calibration(
            records.graph, records.object_map, records.true_objects, matches, judged, self._truth, protocol
        )
        if missing:
            self._unavailable["calibration"] = missing if len(self._truth) else NO_TRUTH
        if records.status is None:
            self._unavailable["counters"] = NO_STATUS
        self._unavailable["run_time"] = NO_RUN_TIME
        results = {
            "trajectory": describe_trajectories({"estimate": estimate, "odometry": odometry, "online": online}),
            "associations": nothing["associations"] if labelled is None else self._describe_associations(labelled),
            "landmarks": landmarks or nothing["landmarks"],
            "closures": nothing["closures"] | self._describe_closures(judged, queries),
            "relocalization": self._describe_relocalization(T_world_map) or nothing["relocalization"],
            "calibration": describe_calibration(consistency, protocol.coverage_probability),
            "counters": records.status.counters if records.status else {},
            "unavailable": self._unavailable,
            "protocol": {**plain(protocol), "rules": protocol.describe()},
        }
        return Evaluation(
            protocol,
            plain(results),
            self._unavailable,
            estimate=estimate,
            odometry=odometry,
            online=online,
            closures=judged,
            missed_ns=() if judged is None or queries is None else find_missed(queries, judged),
            consistency=consistency,
        )

    def _measure(self, part: str, compute: Callable[[], _Measured]) -> _Measured | None:
        """What ``compute`` returns; None where it raises the reason why the part is unavailable."""
        try:
            return compute()
        except EvaluationError as error:
            self._unavailable[part] = str(error)
            return None

    def _trajectory(self, part: str, estimate: PoseSeries, no_estimate: str) -> TrajectoryErrors | None:
        protocol = self._protocol

        def compute() -> TrajectoryErrors:
            _require({no_estimate: len(estimate) > 0, NO_TRUTH: len(self._truth) > 0})
            return evaluate_trajectory(
                estimate,
                self._truth,
                max_gap_s=protocol.max_truth_gap_s,
                lengths_m=protocol.relative_lengths_m,
                short_lengths_m=protocol.short_relative_lengths_m,
                start_step=protocol.relative_start_step,
            )

        return self._measure(part, compute)

    def _label_detections(self) -> LabelledDetections:
        records = self._records
        path = self._odometry if len(self._odometry) else self._truth
        _require(
            {
                "no associations in the log (/slam/associations)": bool(records.associations),
                NO_DETECTION_TRUTH: bool(records.detection_truths),
                "neither odometry nor ground truth, so travel between measurements is unknown": len(path) > 0,
            }
        )
        aliases = find_aliases(records.object_map)
        labelled = label_detections(records.associations, records.detection_truths, path, aliases=aliases)
        count = len(records.associations)
        _require({f"none of {count} frames has a stamp with truth: the reference is of another drive":
                  labelled.frame_count > 0})  # fmt: skip
        return labelled

    def _describe_associations(self, labelled: LabelledDetections) -> dict[str, Any]:
        objects, confirmed = self._records.object_map, None
        if objects:
            confirmed = [name for name, state in zip(objects.ids, objects.states, strict=True) if state == CONFIRMED]
        return evaluate_associations(labelled, revisit_m=self._protocol.revisit_m, confirmed_landmark_ids=confirmed)

    def _match_by_detections(self, labelled: LabelledDetections | None) -> LandmarkMatches | None:
        """Landmarks with their objects by the truth of the detections."""
        map_est, map_gt = self._records.object_map, self._records.true_objects
        if labelled is None or map_est is None or map_gt is None:
            return None
        identities = identify_landmarks(labelled.table)
        return match_by_detections(map_est, map_gt, identities, has_prior_map=self._records.has_prior_map)

    def _describe_landmarks(
        self, labelled: LabelledDetections | None, matches: LandmarkMatches | None, T_world_map: FloatArray | None
    ) -> dict[str, Any]:
        map_est, map_gt, protocol = self._records.object_map, self._records.true_objects, self._protocol
        if map_est is None or map_gt is None:
            raise EvaluationError(NO_MAP if map_est is None else NO_TRUE_OBJECTS)
        if matches is None:
            if T_world_map is None:
                raise EvaluationError(NO_MATCH)
            matches = match_by_position(map_est, map_gt, T_world_map, max_distance_m=protocol.match_distance_m)
        return evaluate_landmarks(
            map_est,
            map_gt,
            matches,
            protocol,
            path_gt=self._truth,
            T_world_map=T_world_map,
            object_detection_counts=count_detections(labelled.table) if labelled else None,
        )

    def _judge_closures(self) -> tuple[pd.DataFrame | None, pd.DataFrame | None]:
        """The candidates, None without any; and the keyframes that may be revisits, None where they are not known."""
        graph, records, truth = self._records.graph, self._records.closures, self._truth
        if not records and (graph is None or not len(truth)):
            self._unavailable["closures"] = "no loop-closure candidate in the log"
            return None, None
        is_own_map = not self._records.has_prior_map
        there = {NO_TRUTH: len(truth) > 0, NO_KEYFRAMES: graph is not None, IN_GIVEN_MAP: is_own_map}
        self._measure("closures", lambda: _require(there))
        if graph is None or not is_own_map:
            return judge_closures(find_final_decisions(records), {}, truth, self._protocol), None
        ids, stamps_ns = graph.keyframe_ids, graph.keyframe_stamps_ns
        stamp_of_keyframe = dict(zip(ids.tolist(), stamps_ns.tolist(), strict=True))
        judged = judge_closures(find_final_decisions(records), stamp_of_keyframe, truth, self._protocol)
        return judged, find_revisits(ids, stamps_ns, truth, self._protocol) if len(truth) and len(ids) else None

    def _describe_closures(self, judged: pd.DataFrame | None, queries: pd.DataFrame | None) -> dict[str, Any]:
        if judged is None:
            return {}
        figures = describe_closures(judged, self._protocol, has_truth=len(self._truth) > 0)
        return figures if queries is None else figures | describe_revisits(queries, judged)

    def _describe_relocalization(self, T_world_estimate: FloatArray | None) -> dict[str, Any] | None:
        records = self._records
        if not records.statuses:
            self._unavailable["relocalization"] = NO_STATUS
            return None
        is_given = records.has_prior_map
        if self._map_alignment is not None and not is_given:
            self._unavailable["map_alignment"] = "not used: in this log the robot made its own map and was given none"
        is_located = is_given and self._map_alignment is not None
        figures = evaluate_relocalization(
            records,
            self._truth,
            self._odometry,
            self._protocol,
            T_world_map=self._map_alignment if is_located else T_world_estimate,
            method="map" if is_located else "trajectory" if is_given else "closure",
        )
        undecided, fixes = figures["undecided_count"], figures["fix_count"]
        if undecided:
            reason = "no truth at their stamps" if len(self._truth) else NO_TRUTH
            self._unavailable["relocalization"] = f"{undecided} of {fixes} fixes: {reason}"
        return figures


def _require(is_there: Mapping[str, bool]) -> None:
    """Raise the first reason that applies.

    Raises:
        EvaluationError: something is not there.
    """
    for reason, there in is_there.items():
        if not there:
            raise EvaluationError(reason)


def _describe_nothing(protocol: Protocol) -> dict[str, Any]:
    """The keys of each part where nothing could be measured."""
    no_poses, no_objects = series_of(()), ObjectMapRecord.of_objects((), np.zeros((0, 3)), (), ())
    no_landmarks = match_by_detections(no_objects, no_objects, {})
    no_closures = judge_closures((), {}, no_poses, protocol)
    no_queries = find_revisits(no_poses.stamps_ns, no_poses.stamps_ns, no_poses, protocol)
    described: dict[str, Any] = undefined(
        {
            "associations": evaluate_associations(label_detections((), (), no_poses)),
            "landmarks": evaluate_landmarks(no_objects, no_objects, no_landmarks),
            "closures": describe_closures(no_closures, protocol, has_truth=False)
            | describe_revisits(no_queries, no_closures),
            "relocalization": evaluate_relocalization(EvaluationRecords(), no_poses, no_poses, protocol),
        }
    )
    return described
