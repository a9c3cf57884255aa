"""Object maps and frames of detections for the tests."""

from __future__ import annotations

import numpy as np

from logs.messages import DetectionAssociations, DetectionTruth, ObjectMapRecord
from slam.common.arrays import FloatArray, IntArray


def object_map(
    ids: tuple[str, ...],
    positions: FloatArray,
    labels: tuple[str, ...],
    *,
    states: tuple[str, ...] | None = None,
    reasons: tuple[str, ...] | None = None,
    first_seen_ns: IntArray | None = None,
) -> ObjectMapRecord:
    vocabulary = tuple(sorted(set(labels)))
    count = len(ids)
    seen = np.zeros(count, dtype=np.int64) if first_seen_ns is None else first_seen_ns
    return ObjectMapRecord(
        stamp_ns=0,
        frame_id="map",
        vocabulary=vocabulary,
        ids=ids,
        positions=np.asarray(positions, dtype=np.float64).reshape(-1, 3),
        covariances=np.tile(np.eye(3), (count, 1, 1)),
        class_probabilities=np.array([[float(v == label) for v in vocabulary] for label in labels]).reshape(
            count, len(vocabulary)
        ),
        states=states or ("confirmed",) * count,
        reasons=reasons or ("",) * count,
        observation_counts=np.full(count, 5, dtype=np.int64),
        first_seen_ns=seen,
        last_seen_ns=seen,
    )


def frames(
    *detections: list[tuple[str, str, bool]], stamps_ns: list[int] | None = None
) -> tuple[list[DetectionAssociations], list[DetectionTruth]]:
    """From (true id, landmark id, created) of each detection of each frame; stamps are 1 s apart from 0."""
    at = stamps_ns or [index * 1_000_000_000 for index in range(len(detections))]
    associations = [
        DetectionAssociations(t, tuple(d[1] for d in frame), np.array([d[2] for d in frame], dtype=np.bool_))
        for t, frame in zip(at, detections, strict=True)
    ]
    truths = [DetectionTruth(t, tuple(d[0] for d in frame)) for t, frame in zip(at, detections, strict=True)]
    return associations, truths
