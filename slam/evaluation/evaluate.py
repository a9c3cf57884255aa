"""From the records of a log to an evaluation."""

from __future__ import annotations

from collections.abc import Callable
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
from slam.evaluation.metrics.relocalization import describe_losses, evaluate_relocalization
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

_NO_POSES = series_of(())
_NO_OBJECTS = ObjectMapRecord.of_objects((), np.zeros((0, 3)), (), ())
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
    def __init__(self, records: EvaluationRecords, protocol: Protocol, map_alignment: FloatArray | None) -> None:
        self._records = records
        self._protocol = protocol
        self._map_alignment = map_alignment
        self._unavailable: dict[str, str] = {}
        self._truth = records.true_path
        self._odometry = records.odometry_path

    def run(self) -> Evaluation:
        records, final, protocol = self._records, self._records.final_path, self._protocol
        trajectories = {
            "estimate": self._trajectory("trajectory", final, self._truth, NO_TRAJECTORY),
            "odometry": self._trajectory("odometry", self._odometry, self._truth, NO_ODOMETRY),
            "online": self._trajectory("online", records.online_path, self._truth, "no /slam/pose in the log"),
        }
        best = trajectories["estimate"] or trajectories["online"]
        T_world_map = best.alignment.T_world_map if best else None
        labelled = self._label_detections()
        matches = self._match_by_detections(labelled)
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
            "trajectory": describe_trajectories(trajectories),
            "associations": self._describe_associations(labelled),
            "landmarks": self._describe_landmarks(labelled, matches, T_world_map),
            "closures": self._describe_closures(judged, queries),
            "relocalization": self._describe_relocalization(T_world_map),
            "calibration": describe_calibration(consistency, protocol.coverage_probability),
            "counters": records.status.counters if records.status else {},
            "unavailable": self._unavailable,
            "protocol": {**plain(protocol), "rules": protocol.describe()},
        }
        return Evaluation(
            protocol,
            plain(results),
            self._unavailable,
            estimate=trajectories["estimate"],
            odometry=trajectories["odometry"],
            online=trajectories["online"],
            closures=judged,
            missed_ns=() if judged is None or queries is None else find_missed(queries, judged),
            consistency=consistency,
        )

    def _measure(
        self, part: str, compute: Callable[[], _Measured], missing: dict[str, bool] | None = None
    ) -> _Measured | None:
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

    def _label_detections(self) -> LabelledDetections | None:
        records = self._records
        path = self._odometry if len(self._odometry) else self._truth

        def label() -> LabelledDetections:
            aliases = find_aliases(records.object_map)
            labelled = label_detections(records.associations, records.detection_truths, path, aliases=aliases)
            if labelled.frame_count == 0:
                raise EvaluationError(
                    f"none of {len(records.associations)} frames has a stamp with truth: the reference is of "
                    "another drive"
                )
            return labelled

        missing = {
            "no associations in the log (/slam/associations)": not records.associations,
            NO_DETECTION_TRUTH: not records.detection_truths,
            "neither odometry nor ground truth, so travel between measurements is unknown": not len(path),
        }
        return self._measure("associations", label, missing)

    def _describe_associations(self, labelled: LabelledDetections | None) -> dict[str, Any]:
        if labelled is None:
            return dict.fromkeys(evaluate_associations(label_detections((), (), _NO_POSES)))
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
        if matches is None and map_est is not None and map_gt is not None and T_world_map is not None:
            matches = match_by_position(map_est, map_gt, T_world_map, max_distance_m=protocol.match_distance_m)
        figures = self._measure(
            "landmarks",
            lambda: evaluate_landmarks(
                map_est or _NO_OBJECTS,
                map_gt or _NO_OBJECTS,
                matches or match_by_detections(_NO_OBJECTS, _NO_OBJECTS, {}),
                protocol,
                path_gt=self._truth,
                T_world_map=T_world_map,
                object_detection_counts=count_detections(labelled.table) if labelled else None,
            ),
            {NO_MAP: map_est is None, NO_TRUE_OBJECTS: map_gt is None, NO_MATCH: matches is None},
        )
        nothing = match_by_detections(_NO_OBJECTS, _NO_OBJECTS, {})
        return figures or dict.fromkeys(evaluate_landmarks(_NO_OBJECTS, _NO_OBJECTS, nothing))

    def _judge_closures(self) -> tuple[pd.DataFrame | None, pd.DataFrame | None]:
        """The candidates, None without any; and the keyframes that may be revisits, None where they are not known."""
        graph, records, truth = self._records.graph, self._records.closures, self._truth
        if not records and (graph is None or not len(truth)):
            self._unavailable["closures"] = "no loop-closure candidate in the log"
            return None, None
        missing = {
            NO_TRUTH: not len(truth),
            NO_KEYFRAMES: graph is None,
            IN_GIVEN_MAP: self._records.has_prior_map,
        }
        reason = next((why for why, is_missing in missing.items() if is_missing), "")
        if reason:
            self._unavailable["closures"] = reason
        if graph is None or self._records.has_prior_map:
            return judge_closures(find_final_decisions(records), {}, truth, self._protocol), None
        ids, stamps_ns = graph.keyframe_ids, graph.keyframe_stamps_ns
        stamp_of_keyframe = dict(zip(ids.tolist(), stamps_ns.tolist(), strict=True))
        judged = judge_closures(find_final_decisions(records), stamp_of_keyframe, truth, self._protocol)
        return judged, find_revisits(ids, stamps_ns, truth, self._protocol) if len(truth) and len(ids) else None

    def _describe_closures(self, judged: pd.DataFrame | None, queries: pd.DataFrame | None) -> dict[str, Any]:
        protocol, has_truth = self._protocol, len(self._truth) > 0
        nothing = judge_closures((), {}, _NO_POSES, protocol)
        if judged is None:
            figures = undefined(describe_closures(nothing, protocol, has_truth=False))
        else:
            figures = describe_closures(judged, protocol, has_truth=has_truth)
        if judged is None or queries is None:
            no_queries = find_revisits(_NO_POSES.stamps_ns, _NO_POSES.stamps_ns, _NO_POSES, protocol)
            return {**figures, **undefined(describe_revisits(no_queries, nothing))}
        return {**figures, **describe_revisits(queries, judged)}

    def _describe_relocalization(self, T_world_estimate: FloatArray | None) -> dict[str, Any]:
        records = self._records
        if not records.statuses:
            self._unavailable["relocalization"] = NO_STATUS
            return {"losses": [], "lost_time_ratio": None, "method": None, **undefined(describe_losses([]))}
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
