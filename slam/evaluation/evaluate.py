"""From the records of a log to an evaluation."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import pandas as pd

from logs.closures import find_final_decisions
from logs.container.json_text import plain
from slam.common.arrays import FloatArray
from slam.common.errors import EvaluationError
from slam.evaluation.inputs.protocol import Protocol
from slam.evaluation.inputs.records import EvaluationRecords
from slam.evaluation.inputs.synchronization import PoseSeries
from slam.evaluation.metrics.association import (
    count_detections,
    evaluate_associations,
    find_aliases,
    identify_landmarks,
    label_detections,
)
from slam.evaluation.metrics.calibration import evaluate_calibration
from slam.evaluation.metrics.landmarks import evaluate_landmarks, match_by_detections
from slam.evaluation.metrics.relocalization import evaluate_relocalization
from slam.evaluation.metrics.trajectory import TrajectoryErrors, evaluate_trajectory
from slam.evaluation.place_recognition.closures import describe_closures, judge_closures
from slam.evaluation.place_recognition.revisits import describe_revisits, find_revisits
from slam.evaluation.result import Evaluation, describe_trajectories

NO_ESTIMATE = {
    "estimate": "no final trajectory (/slam/trajectory_stamped): the run was not finished",
    "odometry": "no odometry in the log, or several topics of it: choose one with --topic odometry=/topic",
    "online": "no /slam/pose in the log",
}
NO_STATUS = "no status in the log (/slam/status)"
NO_TRUTH = "no ground truth: pass --reference LOG.mcap or record /ground_truth"
NO_DETECTION_TRUTH = "no truth of the detections: pass --reference LOG.mcap or record /ground_truth/detections"
NO_TRUE_OBJECTS = "no true objects: pass --reference LOG.mcap or record /ground_truth/objects"

_Measured = TypeVar("_Measured")


def evaluate(records: EvaluationRecords, *, map_alignment: FloatArray | None = None) -> Evaluation:
    """Measure all that the records allow, by lengths in proportion to the sensor range of the run.

    Args:
        records: of the log.
        map_alignment: ``T_world_map`` (4, 4) of the map in which the robot was to be relocalized, by which its fixes
            there are judged.

    Raises:
        EvaluationError: a pose is not finite.
    """
    return _Evaluator(records, map_alignment).run()


class _Evaluator:
    """Measures part by part; a part that raises :class:`EvaluationError` is unavailable for this reason."""

    def __init__(self, records: EvaluationRecords, map_alignment: FloatArray | None) -> None:
        self._records = records
        range_m = records.sensor_range_m
        self._protocol = Protocol() if range_m is None else Protocol().for_range(range_m)
        self._map_alignment = map_alignment
        self._unavailable: dict[str, str] = {}
        self._truth = records.true_path
        self._odometry = records.odometry_path

    def run(self) -> Evaluation:
        records, protocol = self._records, self._protocol
        paths = {"estimate": records.final_path, "odometry": self._odometry, "online": records.online_path}
        trajectories = {name: self._evaluate_trajectory(name, path) for name, path in paths.items()}
        best = trajectories["estimate"] or trajectories["online"]
        T_world_map = best.alignment.T_world_map if best else None
        labelled = self._measure("associations", self._label_detections)
        matches = self._match_by_detections(labelled)
        judged, queries = self._judge_closures()
        calibration, missing = evaluate_calibration(
            records.graph, records.object_map, records.true_objects, matches, judged, self._truth, protocol
        )
        if missing:
            self._unavailable["calibration"] = missing if len(self._truth) else NO_TRUTH
        landmarks = self._measure("landmarks", lambda: self._evaluate_landmarks(labelled, matches, T_world_map))
        results = {
            "trajectory": describe_trajectories(trajectories),
            "associations": {} if labelled is None else evaluate_associations(labelled, revisit_m=protocol.revisit_m),
            "landmarks": landmarks or {},
            "closures": {} if judged is None else describe_closures(judged, protocol),
            "relocalization": self._measure("relocalization", lambda: self._evaluate_relocalization(T_world_map)) or {},
            "calibration": calibration,
            "counters": records.status.counters if records.status else {},
            "unavailable": self._unavailable,
            "protocol": plain(protocol),
        }
        if judged is not None and queries is not None:
            results["closures"] |= describe_revisits(queries, judged)
        return Evaluation(plain(results), **trajectories, closures=judged)

    def _measure(self, part: str, compute: Callable[[], _Measured]) -> _Measured | None:
        """What ``compute`` returns; None where it raises the reason why the part is unavailable."""
        try:
            return compute()
        except EvaluationError as error:
            self._unavailable[part] = str(error)
            return None

    def _evaluate_trajectory(self, name: str, path: PoseSeries) -> TrajectoryErrors | None:
        def compute() -> TrajectoryErrors:
            _require({NO_ESTIMATE[name]: len(path) > 0, NO_TRUTH: len(self._truth) > 0})
            gap_s, kidnapping_m = self._protocol.max_truth_gap_s, self._protocol.revisit_m
            return evaluate_trajectory(path, self._truth, max_gap_s=gap_s, kidnapping_m=kidnapping_m)

        return self._measure("trajectory" if name == "estimate" else name, compute)

    def _label_detections(self) -> pd.DataFrame:
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
        _require({f"none of {count} frames has detections with truth: the reference is of another drive":
                  not labelled.empty})  # fmt: skip
        return labelled

    def _match_by_detections(self, labelled: pd.DataFrame | None) -> pd.DataFrame | None:
        """Landmarks with their objects by the truth of the detections."""
        map_est, map_gt = self._records.object_map, self._records.true_objects
        if labelled is None or map_est is None or map_gt is None:
            return None
        return match_by_detections(
            map_est, map_gt, identify_landmarks(labelled), has_prior_map=self._records.has_prior_map
        )

    def _evaluate_landmarks(
        self, labelled: pd.DataFrame | None, matches: pd.DataFrame | None, T_world_map: FloatArray | None
    ) -> dict[str, Any]:
        map_est, map_gt = self._records.object_map, self._records.true_objects
        if map_est is None or map_gt is None:
            raise EvaluationError("no object map in the log (/slam/map)" if map_est is None else NO_TRUE_OBJECTS)
        if labelled is None or matches is None:
            raise EvaluationError("the true objects of landmarks are known by detections with truth: see associations")
        return evaluate_landmarks(
            map_est,
            map_gt,
            matches,
            self._protocol,
            path_gt=self._truth,
            T_world_map=T_world_map,
            object_detection_counts=count_detections(labelled),
        )

    def _judge_closures(self) -> tuple[pd.DataFrame | None, pd.DataFrame | None]:
        """The candidates, None without any; and the keyframes that may be revisits, None where they are not known."""
        graph, records, truth = self._records.graph, self._records.closures, self._truth
        if not records and (graph is None or not len(truth)):
            self._unavailable["closures"] = "no loop-closure candidate in the log"
            return None, None
        is_own_map = not self._records.has_prior_map
        there = {
            NO_TRUTH: len(truth) > 0,
            "no keyframes in the log (/slam/graph), so revisits are unknown": graph is not None,
            "closures with keyframes of a given map have no truth in this log: see relocalization": is_own_map,
        }
        self._measure("closures", lambda: _require(there))
        judged = judge_closures(find_final_decisions(records), truth, self._protocol)
        if graph is None or not is_own_map or not len(truth) or not len(graph.keyframe_ids):
            return judged, None
        return judged, find_revisits(graph.keyframe_ids, graph.keyframe_stamps_ns, truth, self._protocol)

    def _evaluate_relocalization(self, T_world_estimate: FloatArray | None) -> dict[str, Any]:
        records = self._records
        _require({NO_STATUS: bool(records.statuses)})
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
