"""Object maps and frames of detections for the tests."""

from dataclasses import replace

import numpy as np

from logs.messages import DetectionAssociations, DetectionTruth, ObjectMapRecord
from slam.common.arrays import FloatArray, IntArray


def object_map(
    ids: tuple[str, ...],
    positions: FloatArray,
    labels: tuple[str, ...],
    *,
    states: tuple[str, ...] | None = None,
    first_seen_ns: IntArray | None = None,
) -> ObjectMapRecord:
    vocabulary = tuple(sorted(set(labels)))
    placed = np.asarray(positions, float).reshape(-1, 3)
    classes = [vocabulary.index(label) for label in labels]
    record = ObjectMapRecord.of_objects(ids, placed, classes, vocabulary, sigma_m=1.0, observations=5)
    seen_ns = record.first_seen_ns if first_seen_ns is None else first_seen_ns
    return replace(record, states=states or record.states, first_seen_ns=seen_ns, last_seen_ns=seen_ns)


def frames(
    *detections: list[tuple[str, str, bool]], stamps_ns: list[int] | None = None
) -> tuple[list[DetectionAssociations], list[DetectionTruth]]:
    """From (true id, landmark id, created) of each detection of each frame; stamps are 1 s apart from 0."""
    at = stamps_ns or [index * 1_000_000_000 for index in range(len(detections))]
    associations = [
        DetectionAssociations(t, tuple(d[1] for d in frame), np.array([d[2] for d in frame], bool))
        for t, frame in zip(at, detections, strict=True)
    ]
    truths = [DetectionTruth(t, tuple(d[0] for d in frame)) for t, frame in zip(at, detections, strict=True)]
    return associations, truths
