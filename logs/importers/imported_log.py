"""Logs of whole drives as importers and the simulator write them: records on topics, and where they came from."""

from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path

from logs.errors import LogError
from logs.messages import DetectionTruth, GeodeticFix, GroundTruthPose, ObjectDetections, ObjectMapRecord, Odometry
from logs.records import frozen
from logs.selection import DETECTION_TRUTH_TOPIC, GROUND_TRUTH_TOPIC, OBJECT_TRUTH_TOPIC
from logs.writer import LogWriter

DriveRecord = Odometry | ObjectDetections | GeodeticFix | GroundTruthPose | DetectionTruth | ObjectMapRecord

TOPICS: dict[type[DriveRecord], str] = {
    Odometry: "/odom",
    ObjectDetections: "/detections",
    GeodeticFix: "/fix",
    GroundTruthPose: GROUND_TRUTH_TOPIC,
    DetectionTruth: DETECTION_TRUTH_TOPIC,
    ObjectMapRecord: OBJECT_TRUTH_TOPIC,
}
"""A map is that of the true objects."""


@frozen
class DriveSummary:
    """What was written: messages a topic, objects detected, seconds from the first record to the last."""

    message_counts: dict[str, int]
    detection_count: int
    duration_s: float


def write_drive(
    output: Path, records: Iterable[DriveRecord], metadata: Mapping[str, str], name: str = "source"
) -> DriveSummary:
    """Write records, which come in the order of their stamps, and ``metadata`` under ``name``.

    Raises:
        UnwritableLogError: the log cannot be written.
    """
    message_counts: Counter[str] = Counter()
    detection_count = 0
    first_ns = last_ns = 0
    with LogWriter(output, refusals=(LogError,)) as writer:
        writer.add_metadata(name, metadata)
        for record in records:
            topic = TOPICS[type(record)]
            writer.write(topic, record)
            last_ns = record.stamp_ns
            if not message_counts:
                first_ns = last_ns
            message_counts[topic] += 1
            if isinstance(record, ObjectDetections):
                detection_count += len(record.labels)
    return DriveSummary(dict(message_counts), detection_count, (last_ns - first_ns) * 1e-9)
