"""A drive with truth, as a benchmark reads it."""

from collections.abc import Iterable, Mapping
from pathlib import Path

from logs.container.limits import RESULT_LIMITS
from logs.messages import GroundTruthPose, ObjectDetections, Odometry, Record, Transform
from logs.reader import LogReader
from logs.selection import select_topics
from logs.topics import RecordKind
from slam.common.config import Config
from slam.common.errors import EvaluationError
from slam.evaluation.inputs.synchronization import PoseSeries, series_of
from slam.prepared_log import calibrate_logs

DriveRecord = Odometry | ObjectDetections | GroundTruthPose | Transform


def read_true_drive(
    path: Path, config: Config, topics: Mapping[str, str] | None
) -> tuple[list[DriveRecord], PoseSeries, Config]:
    """The records of a drive, its true poses, and the configuration with what its log tells of the robot.

    Raises:
        LogError: the log cannot be read.
        SlamError: it holds no truth.
    """
    needed = (RecordKind.ODOMETRY, RecordKind.DETECTIONS, RecordKind.GROUND_TRUTH)
    with LogReader(path, RESULT_LIMITS) as reader:
        selection = select_topics(reader.topics(), topics, needed=needed)
        records = [entry.record for entry in reader.records(selection) if isinstance(entry.record, DriveRecord)]
    truth = truth_of(records)
    if not truth:
        raise EvaluationError(f"{path} holds no ground truth, so no place in it is known; see --topic ground_truth=")
    if config.calibrate:
        config = calibrate_logs([path], config, topics=topics).config
    return records, truth, config


def truth_of(records: Iterable[Record]) -> PoseSeries:
    """The true poses among records."""
    return series_of((each.stamp_ns, each.T_world_body) for each in records if isinstance(each, GroundTruthPose))
