"""What has to be known of a whole log before it is made worse."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from logs.messages import DetectionTruth, GroundTruthPose, ObjectDetections, Odometry, Transform
from logs.reader import LogReader
from logs.selection import Selection
from logs.topics import RecordKind
from slam.common.arrays import FloatArray
from slam.common.errors import SimulationError
from slam.frontend.input.sensor_frames import SensorFrames
from slam.simulation.degradation import (
    DegradationConfig,
    Donors,
    in_view,
    join_detections,
    select_detections,
)

_DEFAULT_BODY_FRAME = "base_link"
_UNCHANGED = 1e-9  # transforms that differ by no more are the same

_Stamped = Odometry | ObjectDetections | GroundTruthPose | DetectionTruth


@dataclass(slots=True)
class LogSurvey:
    """What is in a log.

    ``moving``: the (parent, child) frames whose transform changes, ``moving_topics`` the topics that tell them;
    ``first_ns``, ``last_ns``: the earliest and latest stamp of odometry, detections and truths.
    """

    labels: set[str] = field(default_factory=set)
    detection_frames: set[str] = field(default_factory=set)
    odom_frame: str = ""
    body_frame: str = _DEFAULT_BODY_FRAME
    frames: SensorFrames = field(default_factory=SensorFrames)
    moving: set[tuple[str, str]] = field(default_factory=set)
    moving_topics: set[str] = field(default_factory=set)
    first_ns: int = 2**63 - 1
    last_ns: int = 0

    def R_body_sensor(self, frame: str) -> FloatArray:
        """How the sensor ``frame`` is turned on the body; not at all where no transform tells."""
        T_body_sensor = None if frame in ("", self.body_frame) else self.frames.find(self.body_frame, frame)
        return np.eye(3) if T_body_sensor is None else T_body_sensor[:3, :3]


def survey_log(reader: LogReader, selection: Selection) -> LogSurvey:
    """One pass over the topics of ``selection``.

    Raises:
        SimulationError: there is no detection.
    """
    survey = LogSurvey()
    T_parent_child: dict[tuple[str, str], FloatArray] = {}
    has_odometry = False
    for topic, _, record in reader.records(selection):
        if isinstance(record, Transform):
            first = T_parent_child.setdefault(edge(record), record.T_parent_child)
            if np.abs(first - record.T_parent_child).max() > _UNCHANGED:
                survey.moving.add(edge(record))
                survey.moving_topics.add(topic)
            survey.frames.add(record)
        elif isinstance(record, _Stamped):
            survey.first_ns = min(record.stamp_ns, survey.first_ns)
            survey.last_ns = max(record.stamp_ns, survey.last_ns)
            if isinstance(record, ObjectDetections):
                survey.labels.update(record.labels)
                survey.detection_frames.add(record.frame_id)
            elif isinstance(record, Odometry) and not has_odometry:
                has_odometry = True
                survey.odom_frame, survey.body_frame = record.frame_id, record.child_frame_id
    if not survey.labels:
        raise SimulationError(f"{reader.path}: no object is detected in it, so there is nothing to degrade")
    return survey


def find_donors(
    reader: LogReader, selection: Selection, survey: LogSurvey, config: DegradationConfig, labels: tuple[str, ...]
) -> Donors:
    """All detections that are in view and have one of ``labels``.

    Raises:
        SimulationError: there is none.
    """
    found = []
    only_detections = Selection(dict.fromkeys(selection.topics_of(RecordKind.DETECTIONS), (RecordKind.DETECTIONS,)))
    for _, _, record in reader.records(only_detections):
        if isinstance(record, ObjectDetections):
            positions = record.positions @ survey.R_body_sensor(record.frame_id).T
            wanted = np.array([label in labels for label in record.labels], dtype=np.bool_)
            found.append(select_detections(replace(record, positions=positions), in_view(positions, config) & wanted))
    donors = join_detections(*found)
    if not donors.labels:
        raise SimulationError("no detection is in view, so false positives have no model; widen the view")
    return Donors.of(donors)


def refuse_shared_topics(selection: Selection, config: DegradationConfig) -> None:
    """Refuse a topic that would have to be rewritten and plays several parts, as frames that are the odometry do.

    Raises:
        SimulationError: there is one.
    """
    for topic, kinds in selection.kinds.items():
        if len(kinds) > 1 and (config.reversed or (RecordKind.ODOMETRY in kinds and config.changes_odometry)):
            parts = " and ".join(kinds)
            raise SimulationError(f"{topic} is {parts} in one and cannot be rewritten; record a topic for each")


def refuse_odometry_frame(survey: LogSurvey, config: DegradationConfig) -> None:
    """Refuse detections in the frame of the odometry, if it has to be known from where they were seen.

    Raises:
        SimulationError: there are some.
    """
    if config.needs_bearings and survey.odom_frame in survey.detection_frames - {"", survey.body_frame}:
        raise SimulationError(
            f"detections are in {survey.odom_frame!r}, the frame of the odometry, which tells neither their range nor "
            "their bearing: no view and no false positives without that; record them in a sensor's frame"
        )


def edge(transform: Transform) -> tuple[str, str]:
    """The frames (parent, child) of ``transform``."""
    return transform.parent_frame_id, transform.child_frame_id
