"""The records of an output log, and of a reference log, that an evaluation looks at."""

from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import field, replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic_core import from_json

from logs.container.limits import RESULT_LIMITS
from logs.importers.text_files import read_source_text
from logs.importers.trajectory_files import read_trajectory
from logs.messages import (
    DetectionAssociations,
    DetectionTruth,
    FactorGraphRecord,
    GroundTruthPose,
    LoopClosureRecord,
    ObjectMapRecord,
    Odometry,
    Record,
    SlamPose,
    StatusRecord,
    TrajectoryRecord,
)
from logs.reader import LogReader
from logs.records import frozen
from logs.selection import OUTPUT_PREFIX, Selection, select_all, select_topics
from logs.storage.opening import is_log
from logs.storage.regular_file import AnyPath
from logs.topics import RecordKind
from slam.common.errors import EvaluationError
from slam.evaluation.inputs.synchronization import NO_POSES, PoseSeries, clean_poses, series_of
from slam.evaluation.report.figures import value_at
from slam.localization.state import CALIBRATIONS, OF_ONE_MAP

NO_TRUTH = "no ground truth: pass --reference LOG.mcap or record /ground_truth"
_ESTIMATED_KINDS = frozenset(
    {
        RecordKind.ASSOCIATIONS,
        RecordKind.FACTOR_GRAPH,
        RecordKind.LOOP_CLOSURES,
        RecordKind.OBJECT_MAP,
        RecordKind.SLAM_POSE,
        RecordKind.STATUS,
        RecordKind.TRAJECTORY,
    }
)
_INPUT_KINDS = frozenset(
    {RecordKind.ODOMETRY, RecordKind.GROUND_TRUTH, RecordKind.DETECTION_TRUTH, RecordKind.OBJECT_TRUTH}
)


@frozen
class EvaluationRecords:
    """The records for an evaluation, each kind in the order of the log; of maps and trajectories only the last.

    ``final_path``: empty where the run was not finished; ``online_path``: the poses as they were at their time;
    ``provenance``: the metadata of the replay.
    """

    final_path: PoseSeries = NO_POSES
    online_path: PoseSeries = NO_POSES
    odometry_path: PoseSeries = NO_POSES
    true_path: PoseSeries = NO_POSES
    associations: tuple[DetectionAssociations, ...] = ()
    detection_truths: tuple[DetectionTruth, ...] = ()
    object_map: ObjectMapRecord | None = None
    true_objects: ObjectMapRecord | None = None
    closures: tuple[LoopClosureRecord, ...] = ()
    graph: FactorGraphRecord | None = None
    statuses: tuple[StatusRecord, ...] = ()
    provenance: Mapping[str, str] = field(default_factory=dict)

    @property
    def sensor_range_m(self) -> float | None:
        """The sensor range of the run, estimated or given; None if the log, of any version, does not hold it."""
        estimated, given = (_read_tree(self.provenance.get(name, "")) for name in ("estimated", "configuration"))
        default = value_at(given, "calibration.detection.sensor_range_m")
        range_m = estimated.get("detection.sensor_range_m", default)
        return float(range_m) if isinstance(range_m, int | float) and 0.0 < range_m < np.inf else None

    @property
    def has_prior_map(self) -> bool:
        """Whether the robot was to find itself in the map of an earlier drive."""
        return "map_drives" in self.provenance

    def with_truth_of(self, reference: "EvaluationRecords") -> "EvaluationRecords":
        """These records with the truth of another log, kind by kind where that log has it.

        Raises:
            EvaluationError: the other log has no truth at all.
        """
        if not (reference.true_path or reference.detection_truths or reference.true_objects):
            raise EvaluationError(
                "the reference holds no truth: no pose on /ground_truth, no topic /ground_truth/detections or "
                "/ground_truth/objects; name the one that holds it with --topic ground_truth=/name"
            )
        return replace(
            self,
            true_path=reference.true_path or self.true_path,
            detection_truths=reference.detection_truths or self.detection_truths,
            true_objects=reference.true_objects or self.true_objects,
            odometry_path=self.odometry_path or reference.odometry_path,
        )


def collect_records(records: Iterable[tuple[str, Record]]) -> EvaluationRecords:
    """Sort (topic, record) pairs by what an evaluation needs; other records are passed over.

    An object map on a topic under ``/slam/`` is the estimate, on any other it is the truth.
    """
    of_kind: defaultdict[type[Record], list[Any]] = defaultdict(list)
    true_objects, calibrations = None, 0
    for topic, record in records:
        if isinstance(record, ObjectMapRecord) and not topic.startswith(OUTPUT_PREFIX):
            true_objects = record
            continue
        if isinstance(record, StatusRecord) and record.counters.get(CALIBRATIONS, 0) > calibrations:
            calibrations = record.counters[CALIBRATIONS]
            for kind in OF_ONE_MAP:
                of_kind[kind].clear()
        of_kind[type(record)].append(record)
    last = {kind: every[-1] for kind, every in of_kind.items() if every}
    final = last.get(TrajectoryRecord)
    return EvaluationRecords(
        final_path=NO_POSES if final is None else clean_poses(final.stamps_ns, final.T_map_body),
        online_path=series_of((pose.stamp_ns, pose.T_map_body) for pose in of_kind[SlamPose]),
        odometry_path=series_of((pose.stamp_ns, pose.T_odom_body) for pose in of_kind[Odometry]),
        true_path=series_of((pose.stamp_ns, pose.T_world_body) for pose in of_kind[GroundTruthPose]),
        associations=tuple(of_kind[DetectionAssociations]),
        detection_truths=tuple(of_kind[DetectionTruth]),
        object_map=last.get(ObjectMapRecord),
        true_objects=true_objects,
        closures=tuple(of_kind[LoopClosureRecord]),
        graph=last.get(FactorGraphRecord),
        statuses=tuple(of_kind[StatusRecord]),
    )


def read_records(
    path: AnyPath,
    *,
    reference: AnyPath | None = None,
    calib: Path | None = None,
    topics: Mapping[str, str] | None = None,
) -> EvaluationRecords:
    """Read an output log in one pass, and the truth from a reference where one is given.

    Args:
        path: log with the topics under ``/slam/``, and with copies of odometry and truth if it was recorded so.
        reference: log, or file of poses, whose truth replaces that of ``path``, kind by kind.
        calib: of a file of KITTI's poses, if they are of the left camera.
        topics: record kind -> topic, where odometry or truth are not where they usually are; they apply to the
            reference if there is one, else to the output. Before them stands what the replay used.

    Raises:
        UnreadableLogError: a file is missing or no log.
        DatasetError: a file of poses is wrong.
        TopicSelectionError: ``topics`` names a kind or a topic that does not exist.
        EvaluationError: a reference holds no truth.
    """
    if reference is None:
        return _read(path, topics)
    output = _read(path, None)
    if is_log(Path(reference)):
        return output.with_truth_of(_read(reference, topics))
    # Poses in KITTI's format, which has no stamps, are at those of the odometry.
    times_ns = (output.odometry_path or output.final_path).stamps_ns
    calibration = None if calib is None else read_source_text(calib)
    truth = read_trajectory(read_source_text(Path(reference)), times_ns=times_ns, calib=calibration)
    return output.with_truth_of(EvaluationRecords(true_path=PoseSeries(truth.stamps_ns, truth.T_world_body)))


def _read(path: AnyPath, topics: Mapping[str, str] | None) -> EvaluationRecords:
    with LogReader(path, RESULT_LIMITS) as reader:
        there = reader.topics()
        provenance = reader.metadata().get("dslam", {})
        # What the replay used, as it recorded it: the kinds of each topic.
        kinds_of_topic = _read_tree(provenance.get("topics", ""))
        used: dict[str, str] = {
            kind: info.topic
            for info in there
            if isinstance(kinds_of_topic.get(info.topic), list)
            for kind in info.kinds
            if kind in _INPUT_KINDS and kind in kinds_of_topic[info.topic]
        }
        inputs = select_topics(there, {**used, **(topics or {})}, needed=()).kinds
        outputs = select_all(info for info in there if info.topic.startswith(OUTPUT_PREFIX)).kinds
        wanted = {
            topic: kept
            for every, kinds in ((inputs, _INPUT_KINDS), (outputs, _ESTIMATED_KINDS))
            for topic, parts in every.items()
            if (kept := tuple(part for part in parts if part in kinds))
        }
        found = collect_records((entry.topic, entry.record) for entry in reader.records(Selection(wanted)))
        return replace(found, provenance=provenance)


def _read_tree(recorded: str) -> dict[str, Any]:
    """The JSON object in a text; empty if the text holds no object."""
    try:
        tree = from_json(recorded)
    except ValueError:
        return {}
    return tree if isinstance(tree, dict) else {}
