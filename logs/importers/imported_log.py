"""The log that an importer writes: records on their usual topics, and where they came from."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

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
    """What was written: messages a topic, objects detected, first and last stamp (None where there is no record)."""

    message_counts: dict[str, int]
    detection_count: int
    first_stamp_ns: int | None
    last_stamp_ns: int | None


def write_imported_log(output: Path, records: Iterable[ImportedRecord], source: Mapping[str, str]) -> ImportSummary:
    """Write ``records``, which come in the order of their stamps, and ``source`` as the metadata "source".

    Raises:
        UnwritableLogError: the log cannot be written.
    """
    message_counts: Counter[str] = Counter()
    detection_count = 0
    first_stamp_ns = last_stamp_ns = None
    with LogWriter(output) as writer:
        writer.add_metadata("source", dict(source))
        for record in records:
            topic = TOPICS[type(record)]
            writer.write(topic, record, record.stamp_ns)
            message_counts[topic] += 1
            if isinstance(record, ObjectDetections):
                detection_count += len(record.labels)
            first_stamp_ns = record.stamp_ns if first_stamp_ns is None else first_stamp_ns
            last_stamp_ns = record.stamp_ns
    return ImportSummary(dict(message_counts), detection_count, first_stamp_ns, last_stamp_ns)
