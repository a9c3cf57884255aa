"""Position errors and classes of the landmarks of the final map, and the objects without a landmark."""

from contextlib import suppress
from typing import Any

import numpy as np
import pandas as pd

from slam.common.arrays import FloatArray
from slam.common.errors import EvaluationError
from slam.evaluation.inputs.protocol import Protocol
from slam.evaluation.inputs.records import EvaluationRecords
from slam.evaluation.metrics.alignment import align_yaw_translation, aligned_errors_m
from slam.evaluation.metrics.association import FALSE_POSITIVE, identify_landmarks
from slam.evaluation.metrics.statistics import fraction, percentile


def match_by_detections(records: EvaluationRecords, labelled: pd.DataFrame | None) -> pd.DataFrame | None:
    """Match confirmed landmarks by the true object of their detections.

    A landmark without detections with truth shows no object. In a given map landmarks without detections are left out:
    they are of earlier drives.

    Args:
        records: of the log.
        labelled: detections, from :func:`slam.evaluation.metrics.association.label_detections`.

    Returns:
        A row a landmark: ``landmark``, its row in the estimated map; ``object``, the row in the true map, -1 where
        there is none; ``is_object``: it shows an object, though the true map may lack it (a moving one, for instance).
        None where a map or the truth of the detections is missing.
    """
    map_est, map_gt = records.object_map, records.true_objects
    if labelled is None or map_est is None or map_gt is None:
        return None
    landmark_object_ids = identify_landmarks(labelled)
    row_of_object = {name: row for row, name in enumerate(map_gt.ids)}
    rows = np.flatnonzero(map_est.is_confirmed)
    if records.has_prior_map:
        rows = np.array([row for row in rows.tolist() if map_est.ids[row] in landmark_object_ids], dtype=np.int64)
    shown = pd.Series([landmark_object_ids.get(map_est.ids[row], FALSE_POSITIVE) for row in rows], dtype=object)
    objects = np.array([row_of_object.get(name, -1) for name in shown], dtype=np.int64)
    return pd.DataFrame({"landmark": rows, "object": objects, "is_object": shown != FALSE_POSITIVE})


def compute_windowed_errors_m(
    positions_est: FloatArray, positions_gt: FloatArray, seen_at_m: FloatArray, path_length_m: float, window_m: float
) -> FloatArray:
    """Errors (R,) of landmarks after aligning windows of path one by one: the local quality of a map, free of drift.

    Windows of ``window_m`` start every half window until the path is covered. A landmark belongs to the windows in
    which it was first seen, and has an error in each. In each window yaw and translation are aligned by least squares
    (:func:`slam.evaluation.metrics.alignment.align_yaw_translation`); windows with fewer than three
    landmarks, or with all of them in one place, are left out.

    Args:
        positions_est: (N, 3) metres, map frame; N may be 0.
        positions_gt: (N, 3) metres, world frame.
        seen_at_m: (N,) metres of true path at the first measurement; NaN where that is not known, which leaves it out.
        path_length_m: length of the true path.
        window_m: length of a window.
    """
    stride_m = 0.5 * window_m
    # The windows in which anything was seen: a path that jumps may have 10^15 others.
    latest = np.floor(seen_at_m[np.isfinite(seen_at_m)] / stride_m)
    numbers = np.unique(latest[:, None] - np.arange(3))
    is_on_path = (numbers >= 0.0) & (numbers < np.ceil((max(path_length_m - stride_m, 0.0) + 1e-9) / stride_m))
    errors_m = [np.zeros(0)]
    for start_m in (stride_m * numbers[is_on_path]).tolist():
        inside = (seen_at_m >= start_m) & (seen_at_m < start_m + window_m)
        if np.count_nonzero(inside) < 3:  # two leave no residual after their alignment
            continue
        with suppress(EvaluationError):
            T_world_map = align_yaw_translation(positions_est[inside], positions_gt[inside])
            errors_m.append(aligned_errors_m(T_world_map, positions_est[inside], positions_gt[inside]))
    return np.concatenate(errors_m)


def evaluate_landmarks(
    records: EvaluationRecords,
    protocol: Protocol,
    labelled: pd.DataFrame | None,
    matches: pd.DataFrame | None,
    T_world_map: FloatArray | None,
) -> dict[str, Any]:
    """Position errors, classes, precision and recall of the confirmed landmarks, by the keys of the JSON.

    Errors are those after aligning windows of path, and those after the alignment of the whole trajectory ("global").
    Fractions without a denominator are None.

    Args:
        records: of the log; the true path cuts the windows, so without it the windowed error is undefined.
        protocol: the thresholds.
        labelled: detections, from :func:`slam.evaluation.metrics.association.label_detections`.
        matches: from :func:`match_by_detections`.
        T_world_map: (4, 4) alignment of the trajectory; None leaves the error in the global frame undefined.

    Raises:
        EvaluationError: a map or the truth of the detections is missing, or a matched position is not finite.
    """
    map_est, map_gt, path_gt = records.object_map, records.true_objects, records.true_path
    if map_est is None:
        raise EvaluationError("no object map in the log (/slam/map)")
    if map_gt is None:
        raise EvaluationError("no true objects: pass --reference LOG.mcap or record /ground_truth/objects")
    if labelled is None or matches is None:
        raise EvaluationError("the true objects of landmarks are known by detections with truth: see associations")
    rows_est, rows_gt = matches.loc[matches["object"] >= 0, ["landmark", "object"]].to_numpy().T
    positions_est, positions_gt = map_est.positions[rows_est], map_gt.positions[rows_gt]
    if not (np.isfinite(positions_est).all() and np.isfinite(positions_gt).all()):
        raise EvaluationError("the position of a landmark or a true object is not finite")
    windowed_m = global_m = np.zeros(0)
    if path_gt:
        seen_ns = map_est.first_seen_ns[rows_est]
        known = (seen_ns >= path_gt.stamps_ns[0]) & (seen_ns <= path_gt.stamps_ns[-1])
        seen_at_m = np.where(known, path_gt.travelled_at_m(seen_ns), np.nan)
        length_m = path_gt.travelled_m[-1]
        windowed_m = compute_windowed_errors_m(positions_est, positions_gt, seen_at_m, length_m, protocol.window_m)
    if T_world_map is not None:
        global_m = aligned_errors_m(T_world_map, positions_est, positions_gt)
    counts = labelled["object"].value_counts()
    often = {name for name in map_gt.ids if counts.get(name, 0) >= protocol.least_detections}
    found = {map_gt.ids[row] for row in rows_gt}
    class_right = sum(map_est.labels[i] == map_gt.labels[j] for i, j in zip(rows_est, rows_gt, strict=True))
    return {
        "median_error_m": percentile(windowed_m, 50.0),
        "p95_error_m": percentile(windowed_m, 95.0),
        "max_error_m": percentile(windowed_m, 100.0),
        "global_median_error_m": percentile(global_m, 50.0),
        "confirmed_count": len(matches),
        "matched_count": len(rows_est),
        "landmarks_per_object": fraction(len(rows_est), len(found)),
        "precision": fraction(matches["is_object"].sum(), len(matches)),
        "recall": fraction(len(often & found), len(often)),
        "class_accuracy": fraction(class_right, len(rows_est)),
    }
