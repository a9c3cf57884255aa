"""The log that an importer writes: records on their usual topics, and where they came from."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from logs.errors import LogError
from logs.messages import DetectionTruth, GroundTruthPose, ObjectDetections, Odometry
from logs.selection import DETECTION_TRUTH_TOPIC, GROUND_TRUTH_TOPIC
from logs.writer import LogWriter

ImportedRecord = Odometry | ObjectDetections | GroundTruthPose | DetectionTruth

TOPICS: dict[type[ImportedRecord], str] = {
    Odometry: "/odom",
    ObjectDetections: "/detections",
    GroundTruthPose: GROUND_TRUTH_TOPIC,
    DetectionTruth: DETECTION_TRUTH_TOPIC,
}


@dataclass(frozen=True, slots=True)
class ImportSummary:
    """What was written: messages a topic, objects detected, seconds from the first record to the last."""

    message_counts: dict[str, int]
    detection_count: int
    duration_s: float


def write_imported_log(output: Path, records: Iterable[ImportedRecord], source: Mapping[str, str]) -> ImportSummary:
    """Write ``records``, which come in the order of their stamps, and ``source`` as the metadata "source".

    Raises:
        UnwritableLogError: the log cannot be written.
    """
    message_counts: Counter[str] = Counter()
    detection_count = 0
    stamps_ns = [0, 0]
    with LogWriter(output, refusals=(LogError,)) as writer:
        writer.add_metadata("source", dict(source))
        for record in records:
            topic = TOPICS[type(record)]
            writer.write(topic, record, record.stamp_ns)
            stamps_ns = [stamps_ns[0] if message_counts else record.stamp_ns, record.stamp_ns]
            message_counts[topic] += 1
            if isinstance(record, ObjectDetections):
                detection_count += len(record.labels)
    return ImportSummary(dict(message_counts), detection_count, (stamps_ns[1] - stamps_ns[0]) * 1e-9)
