"""``dslam.*`` messages -> records: the mirror of ``logs.encoders``."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from logs import messages as m
from logs.container.pending import LAST_NS
from logs.decoders.parts import detections_record
from logs.schemas import dslam_pb2 as pb
from logs.topics import RecordKind
from logs.validation import LARGEST_M, FloatArray, Refusal, matrix_rows, transforms, usable_covariance

_LARGEST = (1e3 * LARGEST_M) ** 2
"""Of a variance: that of a place as far as can be, whose direction is unknown in each of many steps, is still less."""


def _same_length(count: int, **arrays: Sequence[Any]) -> None:
    for name, array in arrays.items():
        if len(array) != count:
            raise Refusal("lengths disagree", f"{name}: {len(array)} for {count}")


def _integers(values: Sequence[int], count: int, what: str) -> m.IntArray:
    _same_length(count, **{what: values})
    return np.fromiter(values, dtype=np.int64, count=count)


def _finite(array: FloatArray, what: str) -> FloatArray:
    if not np.isfinite(array).all():
        raise Refusal("number is not finite", what)
    if (np.abs(array) > _LARGEST).any():
        raise Refusal("number is out of range", what)
    return array


def _times(values: Sequence[int], count: int, what: str, *, earliest_ns: int = 0) -> m.IntArray:
    times = _integers(values, count, what)
    if count and not earliest_ns <= times.min() <= times.max() <= LAST_NS:
        raise Refusal("time out of range", what)
    return times


def _detections(r: Any, kind: RecordKind, log_time_ns: int, counters: Counter[str]) -> tuple[m.Record, ...]:
    n = len(r.labels)
    return (
        detections_record(
            r.stamp_ns,
            r.frame_id,
            matrix_rows(r.positions, n, 3, "positions"),
            tuple(r.labels),
            matrix_rows(r.scores, n, 1, "scores").ravel(),
            matrix_rows(r.covariances, n, 9, "covariances").reshape(n, 3, 3) if len(r.covariances) else None,
            matrix_rows(r.sizes, n, 3, "sizes") if len(r.sizes) else None,
            _track_ids(r, n),
            counters,
        ),
    )


def _track_ids(r: Any, count: int) -> tuple[str, ...] | None:
    if not len(r.track_ids):
        return None
    _same_length(count, track_ids=r.track_ids)
    return tuple(r.track_ids)


def _detection_truth(r: Any, kind: RecordKind, log_time_ns: int, counters: Counter[str]) -> tuple[m.Record, ...]:
    return (m.DetectionTruth(r.stamp_ns, tuple(r.object_ids)),)


def _associations(r: Any, kind: RecordKind, log_time_ns: int, counters: Counter[str]) -> tuple[m.Record, ...]:
    n = len(r.landmark_ids)
    _same_length(n, created=r.created)
    created = np.fromiter(r.created, dtype=np.bool_, count=n)
    return (m.DetectionAssociations(r.stamp_ns, tuple(r.landmark_ids), created),)


def _object_map(r: Any, kind: RecordKind, log_time_ns: int, counters: Counter[str]) -> tuple[m.Record, ...]:
    n, classes = len(r.ids), len(r.vocabulary)
    _same_length(n, states=r.states, reasons=r.reasons)
    if r.merged_into:
        _same_length(n, merged_into=r.merged_into)
    return (
        m.ObjectMapRecord(
            stamp_ns=r.stamp_ns,
            frame_id=r.frame_id,
            vocabulary=tuple(r.vocabulary),
            ids=tuple(r.ids),
            positions=_finite(matrix_rows(r.positions, n, 3, "positions"), "positions"),
            covariances=_finite(matrix_rows(r.covariances, n, 9, "covariances"), "covariances").reshape(n, 3, 3),
            class_probabilities=_finite(
                matrix_rows(r.class_probabilities, n, classes, "class_probabilities"), "class_probabilities"
            ),
            states=tuple(r.states),
            reasons=tuple(r.reasons),
            observation_counts=_integers(r.observation_counts, n, "observation_counts"),
            first_seen_ns=_times(r.first_seen_ns, n, "first_seen_ns"),
            last_seen_ns=_times(r.last_seen_ns, n, "last_seen_ns"),
            merged_into=tuple(r.merged_into),
        ),
    )


def _trajectory(r: Any, kind: RecordKind, log_time_ns: int, counters: Counter[str]) -> tuple[m.Record, ...]:
    n = len(r.stamps_ns)
    stamps = _times(r.stamps_ns, n, "stamps_ns")
    return (m.TrajectoryRecord(r.stamp_ns, r.frame_id, stamps, transforms(r.map_body, n, "map_body")),)


def _factor_graph(r: Any, kind: RecordKind, log_time_ns: int, counters: Counter[str]) -> tuple[m.Record, ...]:
    k, e, o = len(r.keyframe_ids), len(r.edge_kinds), len(r.observation_landmark_ids)
    return (
        m.FactorGraphRecord(
            stamp_ns=r.stamp_ns,
            keyframe_ids=_integers(r.keyframe_ids, k, "keyframe_ids"),
            # Keyframes of a prior map have no time.
            keyframe_stamps_ns=_times(r.keyframe_stamps_ns, k, "keyframe_stamps_ns", earliest_ns=-1),
            T_map_body=transforms(r.map_body, k, "map_body"),
            edge_keyframe_ids=_integers(r.edge_keyframe_ids, 2 * e, "edge_keyframe_ids").reshape(e, 2),
            edge_transforms=transforms(r.edge_from_to, e, "edge_from_to"),
            edge_covariances=_finite(
                matrix_rows(r.edge_covariances, e, 36, "edge_covariances"), "edge_covariances"
            ).reshape(e, 6, 6),
            edge_kinds=tuple(r.edge_kinds),
            observation_keyframe_ids=_integers(r.observation_keyframe_ids, o, "observation_keyframe_ids"),
            observation_landmark_ids=tuple(r.observation_landmark_ids),
            observation_positions=_finite(
                matrix_rows(r.observation_positions, o, 3, "observation_positions"), "observation_positions"
            ),
            observation_covariances=_finite(
                matrix_rows(r.observation_covariances, o, 9, "observation_covariances"), "observation_covariances"
            ).reshape(o, 3, 3),
            pose_covariances=_finite(
                matrix_rows(r.pose_covariances, k if len(r.pose_covariances) else 0, 36, "pose_covariances"),
                "pose_covariances",
            ).reshape(-1, 6, 6),
            observation_redundancies=_redundancies(r.observation_redundancies, o),
        ),
    )


def _redundancies(values: Sequence[float], count: int) -> m.FloatArray:
    given = count if len(values) else 0
    return _finite(matrix_rows(values, given, 1, "observation_redundancies"), "observation_redundancies").reshape(-1)


def _optional_transform(values: Sequence[float], what: str) -> FloatArray | None:
    return transforms(values, 1, what)[0] if len(values) else None


def _optional_covariance(values: Sequence[float], counters: Counter[str]) -> FloatArray | None:
    if not len(values):
        return None
    return usable_covariance(matrix_rows(values, 6, 6, "covariance"), counters)


def _optional(r: Any, name: str) -> Any:
    return getattr(r, name) if r.HasField(name) else None


def _loop_closure(r: Any, kind: RecordKind, log_time_ns: int, counters: Counter[str]) -> tuple[m.Record, ...]:
    return (
        m.LoopClosureRecord(
            stamp_ns=r.stamp_ns,
            query_keyframe_id=r.query_keyframe_id,
            reference_keyframe_id=r.reference_keyframe_id,
            accepted=r.accepted,
            stage=r.stage,
            reason=r.reason,
            retrieval_distance=r.retrieval_distance,
            inlier_count=r.inlier_count,
            inlier_fraction=r.inlier_fraction,
            score=r.score,
            T_reference_query=_optional_transform(r.reference_query, "reference_query"),
            covariance=_optional_covariance(r.covariance, counters),
            reference_stamp_ns=r.reference_stamp_ns,
            inserted=r.inserted,
            rank=r.rank,
            log_likelihood_ratio=_optional(r, "log_likelihood_ratio"),
            odometry_penalty=_optional(r, "odometry_penalty"),
            posterior_log_odds=_optional(r, "posterior_log_odds"),
            best_rival_log_likelihood_ratio=_optional(r, "best_rival_log_likelihood_ratio"),
            seed_query_keyframe_id=_optional(r, "seed_query_keyframe_id"),
            represented_by_keyframe_id=_optional(r, "represented_by_keyframe_id"),
        ),
    )


def _relocalization(r: Any, kind: RecordKind, log_time_ns: int, counters: Counter[str]) -> tuple[m.Record, ...]:
    return (
        m.RelocalizationRecord(
            stamp_ns=r.stamp_ns,
            success=r.success,
            reason=r.reason,
            T_map_body=_optional_transform(r.map_body, "map_body"),
            covariance=_optional_covariance(r.covariance, counters),
            inlier_count=r.inlier_count,
            score=r.score,
        ),
    )


def _status(r: Any, kind: RecordKind, log_time_ns: int, counters: Counter[str]) -> tuple[m.Record, ...]:
    # Map fields iterate in no particular order; sorted, a record reads the same in every run.
    return (m.StatusRecord(r.stamp_ns, r.state, r.level, r.message, dict(sorted(r.counters.items()))),)


_Function = Callable[[Any, RecordKind, int, Counter[str]], tuple[m.Record, ...]]
DSLAM_DECODERS: dict[str, tuple[Any, _Function]] = {
    "dslam.ObjectDetections": (pb.ObjectDetections, _detections),
    "dslam.DetectionTruth": (pb.DetectionTruth, _detection_truth),
    "dslam.DetectionAssociations": (pb.DetectionAssociations, _associations),
    "dslam.ObjectMap": (pb.ObjectMap, _object_map),
    "dslam.Trajectory": (pb.Trajectory, _trajectory),
    "dslam.FactorGraph": (pb.FactorGraph, _factor_graph),
    "dslam.LoopClosure": (pb.LoopClosure, _loop_closure),
    "dslam.Relocalization": (pb.Relocalization, _relocalization),
    "dslam.Status": (pb.Status, _status),
}
