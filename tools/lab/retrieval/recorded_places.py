"""Queries of place recognition on a drive, recorded so that every descriptor gets the same.

The drive is mapped without closing a loop. Landmarks that are left behind are recorded as entries of an index, and the
submap at every revisit as a query. So the submaps are those that the front end makes of real detections, and no
descriptor influences its later queries.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from logs.messages import GroundTruthPose, LoopClosureRecord
from logs.reader import LogReader
from logs.selection import select_topics
from logs.topics import RecordKind
from slam.common.arrays import BoolArray, FloatArray, IntArray
from slam.common.config import Config
from slam.common.errors import EvaluationError
from slam.common.geometry import invert
from slam.evaluation.inputs.protocol import Protocol
from slam.evaluation.inputs.synchronization import PoseSeries
from slam.evaluation.place_recognition.revisits import find_true_poses
from slam.object_map.landmarks import LandmarkState
from slam.object_map.submap import TRAVERSAL_EXTENT, Submap, gravity_frame, recent_submap
from slam.odometry.keyframe import Keyframe
from slam.place_recognition.retrieval import INACTIVE_RANGES
from slam.self_calibration.calibration import calibrate
from slam.self_calibration.survey import survey
from slam.self_calibration.surveyed_log import SurveyedLog
from slam.system import Slam
from tools.lab.relocalization.known_map import truth_of

INDEX_EVERY_RANGES = 10.0 / 30.0
"""Least travel between two additions to the index, in sensor ranges, as in loop closing."""


@dataclass(frozen=True, slots=True, eq=False)
class MapPart:
    """Landmarks that are added to an index together: ``centres`` (B,) of the landmarks around, which are at
    ``positions`` (N, 3) m in the local frame and have ``labels`` (N,) in ``vocabulary``.
    """

    positions: FloatArray
    labels: IntArray
    centres: IntArray
    vocabulary: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class AskedPlace:
    """A submap at a revisit, most landmarks of which are new. ``parts``: how many the index had taken in; ``allowed``
    (E,): which of its entries are old enough and not in the submap itself; ``entry_positions`` (E, 3) m, in the local
    frame.

    ``T_local_query_gt`` (R, 4, 4): the pose by each earlier keyframe nearby, one being as right as another.
    """

    submap: Submap
    vocabulary: tuple[str, ...]
    parts: int
    allowed: BoolArray
    entry_positions: FloatArray
    T_local_query_gt: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class RecordedPlaces:
    """All of a drive; ``config`` is the one that was calibrated on it."""

    drive: str
    config: Config
    parts: tuple[MapPart, ...]
    asked: tuple[AskedPlace, ...]


def record_places(
    path: Path,
    config: Config,
    *,
    spacing_m: float,
    topics: Mapping[str, str] | None = None,
    on_progress: Callable[[float], None] | None = None,
) -> RecordedPlaces:
    """Map a drive with truth, and record what place recognition is asked at its revisits.

    Args:
        path: the log.
        config: of the estimator; what it leaves open is estimated from the log.
        spacing_m: least true travel between two queries.
        topics: kind -> topic, where the log leaves a choice.
        on_progress: called with the fraction done, in [0, 1].

    Raises:
        LogError: the log cannot be read.
        SlamError: it cannot be mapped, holds no truth, or never comes back.
    """
    with LogReader(path) as reader, threadpool_limits(1):
        kinds = (RecordKind.ODOMETRY, RecordKind.DETECTIONS, RecordKind.GROUND_TRUTH)
        selection = select_topics(reader.topics(), topics, needed=kinds)
        truth = truth_of(e.record for e in reader.records(selection) if isinstance(e.record, GroundTruthPose))
        if not len(truth.stamps_ns):
            raise EvaluationError(
                f"{path} holds no ground truth, so no place in it is known; see --topic ground_truth="
            )
        if config.calibrate:
            surveyed = SurveyedLog.of(entry.record for entry in reader.records(selection))
            config = calibrate(config, survey([surveyed], config.calibration)).config
        recorder = _Recorder(config, truth, spacing_m)
        span_ns = max(int(truth.stamps_ns[-1] - truth.stamps_ns[0]), 1)
        for entry in reader.records(selection):
            if not isinstance(entry.record, GroundTruthPose):
                recorder.process(entry.record)
            elif on_progress is not None:
                on_progress(min(max((entry.record.stamp_ns - int(truth.stamps_ns[0])) / span_ns, 0.0), 1.0))
        recorder.finish()
    if not recorder.asked:
        raise EvaluationError(f"{path}: the drive never comes back to a place, so there is nothing to recognise")
    return RecordedPlaces(path.stem, config, tuple(recorder.parts), tuple(recorder.asked))


class _Recorder(Slam):
    """Maps, and writes down at each keyframe what loop closing would be asked instead of closing loops."""

    def __init__(self, config: Config, truth: PoseSeries, spacing_m: float) -> None:
        super().__init__(config)
        self._truth = truth
        self._protocol = Protocol(revisit_m=config.closure_travel_m)
        self._spacing_m = spacing_m
        self._asked_m = -np.inf
        self._indexed_m = -np.inf
        self._rows = np.zeros(0, dtype=np.int64)
        self.parts: list[MapPart] = []
        self.asked: list[AskedPlace] = []

    def _close_loops(self, keyframe: Keyframe) -> list[LoopClosureRecord]:
        self._index(keyframe.odometry.travel_m)
        self._ask(keyframe)
        return []

    def _index(self, travel_m: float) -> None:
        sensor_range_m = self._config.sensor_range_m
        if travel_m - self._indexed_m < INDEX_EVERY_RANGES * sensor_range_m:
            return
        self._indexed_m = travel_m
        landmarks = self._object_map.rows
        confirmed = landmarks["state"] == LandmarkState.CONFIRMED
        behind = confirmed & (
            landmarks["last_seen_travel_m"] < travel_m - INACTIVE_RANGES * self._config.sensor_range_m
        )
        behind[self._rows] = False
        for segment in np.unique(landmarks["segment"][behind]):
            new = np.flatnonzero(behind & (landmarks["segment"] == segment))
            extent_m = TRAVERSAL_EXTENT * self._config.closure_travel_m
            earliest_m = landmarks["last_seen_travel_m"][new].min() - extent_m
            around = np.flatnonzero(
                confirmed & (landmarks["segment"] == segment) & (landmarks["last_seen_travel_m"] > earliest_m)
            )
            self.parts.append(
                MapPart(
                    landmarks["position_local"][around],
                    self._object_map.classes(around),
                    np.searchsorted(around, new),
                    self._object_map.vocabulary,
                )
            )
            self._rows = np.concatenate([self._rows, new])

    def _ask(self, keyframe: Keyframe) -> None:
        stamp_ns = keyframe.odometry.stamp_ns
        travelled_m = float(self._truth.travelled_at_m(np.array([stamp_ns]))[0])
        if travelled_m - self._asked_m < self._spacing_m or not len(self._rows):
            return
        references = self._references(keyframe)
        if not len(references):
            return
        landmarks = self._object_map.rows
        submap = recent_submap(self._object_map, keyframe, self._config.calibration)
        before_m = keyframe.odometry.travel_m - self._config.closure_travel_m
        still_associated = np.count_nonzero(landmarks["first_seen_travel_m"][submap.rows] < before_m)
        if 2 * still_associated > len(submap):  # nothing is to be recognised where the landmarks were never lost
            return
        self._asked_m = travelled_m
        usable = (landmarks["first_seen_travel_m"] < before_m) & (landmarks["state"] == LandmarkState.CONFIRMED)
        usable[submap.rows] = False
        self.asked.append(
            AskedPlace(
                submap,
                self._object_map.vocabulary,
                len(self.parts),
                usable[self._rows],
                landmarks["position_local"][self._rows],
                references,
            )
        )

    def _references(self, keyframe: Keyframe) -> FloatArray:
        """Poses (R, 4, 4) of the query in the local frame, by the earlier keyframes that it truly comes back to."""
        keyframes = self._mapper.keyframes
        stamps_ns = np.array([each.odometry.stamp_ns for each in keyframes], dtype=np.int64)
        known, T_world_body = find_true_poses(self._truth, stamps_ns, max_gap_s=self._protocol.max_truth_gap_s)
        if not known[-1]:
            return np.zeros((0, 4, 4))
        travelled_m = self._truth.travelled_at_m(stamps_ns)
        apart_m = np.linalg.norm(T_world_body[:, :3, 3] - T_world_body[-1, :3, 3], axis=1)
        near = known & (apart_m <= self._protocol.revisit_distance_m)
        near &= travelled_m <= travelled_m[-1] - self._protocol.revisit_m
        T_local_body = np.stack([keyframes[row].T_local_body for row in np.flatnonzero(near)] or [np.eye(4)])
        if not near.any():
            return np.zeros((0, 4, 4))
        T_reference_query = invert(T_world_body[near]) @ T_world_body[-1]
        return gravity_frame(T_local_body @ T_reference_query)
