"""Consistency of the covariances of a map with its errors.

The normalised estimation error squared (NEES) of an error e with the covariance P is ``e^T P^-1 e``. If P is right and
the errors are normal, it has the chi-squared distribution of the dimension of e (Bar-Shalom, Li and Kirubarajan,
Estimation with Applications to Tracking and Navigation, 2001, section 5.4).
"""

from typing import Any

import numpy as np
import pandas as pd

from slam.common.arrays import FloatArray, least_eigenvalues
from slam.common.geometry import apply, invert, pose_errors, squared_mahalanobis
from slam.evaluation.inputs.records import EvaluationRecords
from slam.evaluation.inputs.synchronization import PoseSeries, are_known

NEEDS = {
    "pose": "keyframes: needs covariances (/slam/graph) and truth, also at the first keyframe, which fixes the map",
    "landmark": "landmarks: needs confirmed landmarks whose true object is known from their detections, and truth at "
    "the first keyframe",
    "closure": "closures: needs an accepted true closure with a covariance",
}
"""Requirements of each kind of error."""


def measure_consistency(errors: FloatArray, covariances: FloatArray) -> dict[str, Any]:
    """Set errors (N, D) against covariances (N, D, D), leaving out those that are not positive definite; N may be 0.

    ``nees``: mean of a degree of freedom, 1 is right, more is overconfident; ``count``: errors used.
    """
    usable = np.isfinite(errors).all(axis=1) & (least_eigenvalues(covariances) > 0.0)
    if not usable.any():
        return {"nees": None, "count": 0}
    squares = squared_mahalanobis(errors[usable], covariances[usable])
    return {"nees": np.mean(squares) / errors.shape[1], "count": len(squares)}


def evaluate_calibration(
    records: EvaluationRecords, matches: pd.DataFrame | None, judged: pd.DataFrame | None
) -> tuple[dict[str, Any], str]:
    """NEES and number of errors of keyframes, landmarks and closures, and why some of them are missing.

    The covariances are those in the map frame, which its first keyframe fixes. So the truth is tied there: no other
    alignment, which would fit the errors away, is made.

    Args:
        records: of the log.
        matches: of confirmed landmarks with true objects, by the truth of their detections.
        judged: candidates, as :func:`slam.evaluation.place_recognition.closures.judge_closures` returns them.
    """
    errors = {}
    graph, map_est, map_gt, truth = records.graph, records.object_map, records.true_objects, records.true_path
    if graph is not None:
        T_world_body = truth.poses_at(graph.keyframe_stamps_ns)
        known = are_known(T_world_body)
        if known[:1].any():
            T_map_world = invert(T_world_body[0] @ invert(graph.T_map_body[0]))
            known[0] = False
            if len(graph.pose_covariances):
                of_keyframes = pose_errors(graph.T_map_body[known], T_map_world @ T_world_body[known])
                errors["pose"] = of_keyframes, graph.pose_covariances[known]
            if map_est is not None and map_gt is not None and matches is not None:
                rows, objects = matches.loc[matches["object"] >= 0, ["landmark", "object"]].to_numpy().T
                of_landmarks = map_est.positions[rows] - apply(T_map_world, map_gt.positions[objects])
                errors["landmark"] = of_landmarks, map_est.covariances[rows]
    if judged is not None:
        errors["closure"] = _closure_errors(judged, truth)
    nothing = (np.zeros((0, 1)), np.zeros((0, 1, 1)))
    parts = {kind: measure_consistency(*errors.get(kind, nothing)) for kind in NEEDS}
    figures = {f"{kind}_{name}": value for kind, part in parts.items() for name, value in part.items()}
    return figures, "; ".join(NEEDS[kind] for kind, part in parts.items() if not part["count"])


def _closure_errors(judged: pd.DataFrame, truth: PoseSeries) -> tuple[FloatArray, FloatArray]:
    """Errors (N, 6) of the accepted true closures, and their covariances (N, 6, 6)."""
    chosen = judged[judged["accepted"] & judged["true"]]
    chosen = chosen[np.array([record.covariance is not None for record in chosen["record"]], dtype=np.bool_)]
    T_world_reference, T_world_query = (
        truth.poses_at(chosen[name].to_numpy()) for name in ("reference_stamp_ns", "stamp_ns")
    )
    T_reference_query = np.array([record.T_reference_query for record in chosen["record"]]).reshape(-1, 4, 4)
    covariances = np.array([record.covariance for record in chosen["record"]]).reshape(-1, 6, 6)
    return pose_errors(T_reference_query, invert(T_world_reference) @ T_world_query), covariances
