"""Where the landmarks of the final map are, what they are called, and which objects have one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from logs.messages import ObjectMapRecord
from slam.common.arrays import FloatArray, IntArray
from slam.common.errors import EvaluationError
from slam.common.geometry import apply
from slam.evaluation.inputs.protocol import Protocol
from slam.evaluation.inputs.synchronization import PoseSeries
from slam.evaluation.metrics.alignment import STANDSTILL_M, align_yaw_translation, principal_spreads
from slam.evaluation.metrics.association import FALSE_POSITIVE
from slam.evaluation.metrics.trajectory import ErrorStatistics, summarize

CONFIRMED = "confirmed"
DEFAULT_PROTOCOL = Protocol()


@dataclass(frozen=True, slots=True, eq=False)
class LandmarkMatches:
    """The confirmed landmarks of a map and the true object of each.

    landmark_rows (C,) rows of the estimated map; object_rows (C,) rows of the true map, -1 where there is none;
    is_object (C,) bool: the landmark shows an object, though the true map may lack it (a moving one, for instance).
    """

    method: Literal["detections", "nearest"]
    landmark_rows: IntArray
    object_rows: IntArray
    is_object: NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class WindowedErrors:
    """Residuals (R,), metres, after each window was aligned by itself; a landmark of two windows stands twice."""

    residuals_m: FloatArray
    horizontal_residuals_m: FloatArray
    window_count: int
    skipped_window_count: int
    landmark_count: int


@dataclass(frozen=True, slots=True, eq=False)
class LandmarkQuality:
    """Quality of the confirmed landmarks; None where there is nothing to count.

    ``windowed`` and ``windowed_horizontal``: residuals after aligning windows of path; ``global_frame``: after the
    alignment of the whole trajectory. ``recall`` is over the true objects that were detected often enough.
    """

    method: Literal["detections", "nearest"]
    confirmed_count: int
    object_landmark_count: int
    matched_count: int
    windowed: ErrorStatistics | None
    windowed_horizontal: ErrorStatistics | None
    window_count: int
    skipped_window_count: int
    windowed_landmark_count: int
    global_frame: ErrorStatistics | None
    class_right_count: int | None
    recallable_object_count: int | None
    recalled_object_count: int | None

    @property
    def precision(self) -> float | None:
        """Confirmed landmarks that are an object, among all confirmed ones."""
        return self.object_landmark_count / self.confirmed_count if self.confirmed_count else None

    @property
    def recall(self) -> float | None:
        """Objects with a confirmed landmark, among those detected often enough."""
        if self.recalled_object_count is None or not self.recallable_object_count:
            return None
        return self.recalled_object_count / self.recallable_object_count

    @property
    def class_accuracy(self) -> float | None:
        """Confirmed landmarks with the class of their object; None where matching used the class already."""
        if self.class_right_count is None or not self.matched_count:
            return None
        return self.class_right_count / self.matched_count


def match_by_detections(
    map_est: ObjectMapRecord,
    map_gt: ObjectMapRecord,
    landmark_object_ids: Mapping[str, str],
    *,
    has_prior_map: bool = False,
) -> LandmarkMatches:
    """Match confirmed landmarks by the true object of their detections; one that got none with truth is no object.

    With ``has_prior_map`` landmarks without detections are left out: they are of earlier drives.
    """
    row_of_object = {name: row for row, name in enumerate(map_gt.ids)}
    rows = _confirmed_rows(map_est)
    if has_prior_map:
        rows = np.array([row for row in rows.tolist() if map_est.ids[row] in landmark_object_ids], dtype=np.int64)
    objects = [landmark_object_ids.get(map_est.ids[row], FALSE_POSITIVE) for row in rows]
    return LandmarkMatches(
        method="detections",
        landmark_rows=rows,
        object_rows=np.array([row_of_object.get(name, -1) for name in objects], dtype=np.int64),
        is_object=np.array([name != FALSE_POSITIVE for name in objects], dtype=np.bool_),
    )


def match_by_position(
    map_est: ObjectMapRecord, map_gt: ObjectMapRecord, T_world_map: FloatArray, *, max_distance_m: float = 2.0
) -> LandmarkMatches:
    """Match confirmed landmarks with the nearest true object of the same class, at most ``max_distance_m`` away.

    Used where no detection has a true id. Errors beyond the limit cannot be seen this way, and the class is right by
    construction.

    Args:
        map_est: positions in the map frame.
        map_gt: positions in the world frame.
        T_world_map: (4, 4), alignment of the whole trajectory.
        max_distance_m: limit of the match.
    """
    rows = _confirmed_rows(map_est)
    positions = apply(T_world_map, map_est.positions[rows])
    labels_est = np.array(map_est.labels, dtype=np.str_)[rows] if len(rows) else np.zeros(0, dtype=np.str_)
    labels_gt = np.array(map_gt.labels, dtype=np.str_)
    object_rows = np.full(len(rows), -1, dtype=np.int64)
    for label in np.unique(labels_est):
        ours, theirs = np.flatnonzero(labels_est == label), np.flatnonzero(labels_gt == label)
        if len(theirs) == 0:
            continue
        distance, nearest = cKDTree(map_gt.positions[theirs]).query(positions[ours])
        near = np.asarray(distance) <= max_distance_m
        object_rows[ours[near]] = theirs[np.asarray(nearest)[near]]
    return LandmarkMatches("nearest", rows, object_rows, object_rows >= 0)


def compute_windowed_errors(
    positions_est: FloatArray,
    positions_gt: FloatArray,
    seen_at_m: FloatArray,
    path_length_m: float,
    protocol: Protocol = DEFAULT_PROTOCOL,
) -> WindowedErrors:
    """Residuals of landmarks after aligning windows of path one by one: the local quality of a map, free of drift.

    Windows ``[s, s + window_m)`` start every ``window_stride_m`` until the path is covered. A landmark belongs to the
    windows in which it was first seen. In each window yaw and translation are aligned by least squares
    (:func:`slam.evaluation.metrics.alignment.align_yaw_translation`); windows with fewer than
    ``window_least_landmarks`` landmarks, or with all of them in one place, are skipped.

    Args:
        positions_est: (N, 3) metres, map frame; N may be 0.
        positions_gt: (N, 3) metres, world frame.
        seen_at_m: (N,) metres of true path at the first measurement; NaN where that is not known, which leaves it out.
        path_length_m: length of the true path.
        protocol: the thresholds.
    """
    window_m, stride_m = protocol.window_m, protocol.window_stride_m
    residuals: list[FloatArray] = []
    skipped = 0
    used = np.zeros(len(positions_est), dtype=np.bool_)
    count = float(np.ceil((max(path_length_m - stride_m, 0.0) + 1e-9) / stride_m))
    numbers = _windows_of(seen_at_m, window_m, stride_m)
    numbers = numbers[numbers < count]
    for start in (stride_m * numbers).tolist():
        inside = (seen_at_m >= start) & (seen_at_m < start + window_m)
        if np.count_nonzero(inside) < protocol.window_least_landmarks or any(
            principal_spreads(points[inside, :2])[0] < STANDSTILL_M for points in (positions_est, positions_gt)
        ):
            skipped += 1
            continue
        alignment = align_yaw_translation(positions_est[inside], positions_gt[inside])
        residuals.append(apply(alignment.T_world_map, positions_est[inside]) - positions_gt[inside])
        used |= inside
    vectors = np.concatenate([np.zeros((0, 3)), *residuals])
    return WindowedErrors(
        residuals_m=np.linalg.norm(vectors, axis=1),
        horizontal_residuals_m=np.linalg.norm(vectors[:, :2], axis=1),
        window_count=len(residuals),
        skipped_window_count=int(min(count, 2.0**62)) - len(numbers) + skipped,
        landmark_count=int(np.count_nonzero(used)),
    )


def _windows_of(seen_at_m: FloatArray, window_m: float, stride_m: float) -> FloatArray:
    """Whole numbers (W,) of the windows in which anything was seen: a path that jumps may have 10^15 others."""
    latest = np.floor(seen_at_m[np.isfinite(seen_at_m)] / stride_m)
    earlier = np.arange(int(np.ceil(window_m / stride_m)) + 1)
    numbers = np.unique(latest[:, None] - earlier)
    return np.asarray(numbers[numbers >= 0.0])


def evaluate_landmarks(
    map_est: ObjectMapRecord,
    map_gt: ObjectMapRecord,
    matches: LandmarkMatches,
    protocol: Protocol = DEFAULT_PROTOCOL,
    *,
    path_gt: PoseSeries | None = None,
    T_world_map: FloatArray | None = None,
    object_detection_counts: Mapping[str, int] | None = None,
) -> LandmarkQuality:
    """Position errors, classes, precision and recall of the confirmed landmarks.

    Args:
        map_est: final map, map frame.
        map_gt: true objects, world frame.
        matches: from :func:`match_by_detections` or :func:`match_by_position`.
        protocol: the thresholds.
        path_gt: true path, which cuts the windows; None leaves the windowed error undefined.
        T_world_map: (4, 4) alignment of the trajectory; None leaves the error in the global frame undefined.
        object_detection_counts: how often each true object was detected; None leaves recall undefined.

    Raises:
        EvaluationError: a matched position is not finite.
    """
    matched = matches.object_rows >= 0
    rows_est, rows_gt = matches.landmark_rows[matched], matches.object_rows[matched]
    positions_est, positions_gt = map_est.positions[rows_est], map_gt.positions[rows_gt]
    if not (np.isfinite(positions_est).all() and np.isfinite(positions_gt).all()):
        raise EvaluationError("a landmark or a true object has a position that is not finite")
    windowed = _windowed(map_est, rows_est, positions_est, positions_gt, path_gt, protocol)
    in_world = None if T_world_map is None else apply(T_world_map, positions_est)
    labels_est, labels_gt = map_est.labels, map_gt.labels
    class_right = None
    if matches.method == "detections":
        class_right = sum(labels_est[i] == labels_gt[j] for i, j in zip(rows_est, rows_gt, strict=True))
    recallable = None
    if object_detection_counts is not None:
        often = {name for name, count in object_detection_counts.items() if count >= protocol.least_detections}
        recallable = often & set(map_gt.ids)
    return LandmarkQuality(
        method=matches.method,
        confirmed_count=len(matches.landmark_rows),
        object_landmark_count=int(np.count_nonzero(matches.is_object)),
        matched_count=len(rows_est),
        windowed=_summarize_or_none(windowed.residuals_m),
        windowed_horizontal=_summarize_or_none(windowed.horizontal_residuals_m),
        window_count=windowed.window_count,
        skipped_window_count=windowed.skipped_window_count,
        windowed_landmark_count=windowed.landmark_count,
        global_frame=None if in_world is None else _summarize_or_none(np.linalg.norm(in_world - positions_gt, axis=1)),
        class_right_count=class_right,
        recallable_object_count=None if recallable is None else len(recallable),
        recalled_object_count=None if recallable is None else len(recallable & {map_gt.ids[j] for j in rows_gt}),
    )


def _windowed(
    map_est: ObjectMapRecord,
    rows_est: IntArray,
    positions_est: FloatArray,
    positions_gt: FloatArray,
    path_gt: PoseSeries | None,
    protocol: Protocol,
) -> WindowedErrors:
    if path_gt is None or len(path_gt.stamps_ns) == 0:
        return WindowedErrors(np.zeros(0), np.zeros(0), 0, 0, 0)
    seen_ns = map_est.first_seen_ns[rows_est]
    known = (seen_ns >= path_gt.stamps_ns[0]) & (seen_ns <= path_gt.stamps_ns[-1])
    seen_at_m = np.where(known, path_gt.travelled_at_m(seen_ns), np.nan)
    return compute_windowed_errors(positions_est, positions_gt, seen_at_m, float(path_gt.travelled_m[-1]), protocol)


def _confirmed_rows(map_est: ObjectMapRecord) -> IntArray:
    return np.array([row for row, state in enumerate(map_est.states) if state == CONFIRMED], dtype=np.int64)


def _summarize_or_none(errors_m: FloatArray) -> ErrorStatistics | None:
    return summarize(errors_m) if len(errors_m) else None
