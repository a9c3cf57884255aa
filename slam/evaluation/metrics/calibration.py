"""Whether the covariances of a map are right: errors measured by the covariance that the map gives them.

The normalised estimation error squared (NEES) of an error e with the covariance P is ``e^T P^-1 e``. If P is right and
the errors are normal, it has the chi-squared distribution of the dimension of e (Bar-Shalom, Li and Kirubarajan,
Estimation with Applications to Tracking and Navigation, 2001, section 5.4).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.spatial.transform import RigidTransform
from scipy.special import gammaincinv

from logs.messages import FactorGraphRecord, ObjectMapRecord
from slam.common.arrays import FloatArray
from slam.common.geometry import apply, invert
from slam.evaluation.inputs.protocol import Protocol
from slam.evaluation.inputs.synchronization import PoseSeries
from slam.evaluation.metrics.landmarks import LandmarkMatches
from slam.evaluation.place_recognition.revisits import find_true_poses

IN_PLANE = {"pose": [2, 3, 4], "landmark": [0, 1], "closure": [2, 3, 4]}
"""Of each kind of error the axes in the plane: heading, forward and left; x and y."""
CALIBRATED = tuple(f"{prefix}{kind}" for kind in IN_PLANE for prefix in ("", "planar_"))

_Errors = tuple[FloatArray, FloatArray]
"""Errors (N, D) and their covariances (N, D, D)."""


@dataclass(frozen=True, slots=True, eq=False)
class Consistency:
    """N errors with their covariances: squares (N,) is the NEES of each, ``dimension`` its degrees of freedom.

    ``unusable_count``: errors that were left out, because their covariance is not positive definite.
    """

    squares: FloatArray
    dimension: int
    unusable_count: int = 0

    @property
    def count(self) -> int:
        """Number of errors."""
        return len(self.squares)

    @property
    def nees(self) -> float:
        """Mean NEES of a degree of freedom: 1 is right, more is overconfident, less is too careful."""
        return float(np.mean(self.squares)) / self.dimension

    def coverage(self, probability: float) -> float:
        """Share of the errors in the region that holds them with ``probability`` if the covariances are right."""
        return float(np.mean(self.squares <= 2.0 * gammaincinv(0.5 * self.dimension, probability)))


def measure_consistency(errors: FloatArray, covariances: FloatArray) -> Consistency | None:
    """Set errors (N, D) against covariances (N, D, D); None where no covariance is usable (N may be 0)."""
    dimension = errors.shape[1]
    finite = np.isfinite(covariances).all(axis=(1, 2)) & np.isfinite(errors).all(axis=1)
    usable = np.zeros(len(errors), dtype=np.bool_)
    usable[finite] = np.linalg.eigvalsh(covariances[finite])[:, 0] > 0.0
    if not usable.any():
        return None
    whitened = np.linalg.solve(covariances[usable], errors[usable][:, :, None])[:, :, 0]
    squares = np.einsum("ni,ni->n", errors[usable], whitened)
    return Consistency(squares, dimension, int(np.count_nonzero(~usable)))


def evaluate_calibration(
    graph: FactorGraphRecord | None,
    map_est: ObjectMapRecord | None,
    map_gt: ObjectMapRecord | None,
    matches: LandmarkMatches | None,
    judged: pd.DataFrame | None,
    truth: PoseSeries,
    protocol: Protocol,
) -> tuple[dict[str, Consistency], str]:
    """NEES of keyframes, landmarks and closures, by names of :data:`CALIBRATED`, and why some of them are missing.

    The covariances are those in the map frame, which its first keyframe fixes. So the truth is tied there: no other
    alignment, which would fit the errors away, is made.

    Args:
        graph: with the covariances of its poses.
        map_est: the final map.
        map_gt: true objects.
        matches: of confirmed landmarks with true objects, by the truth of their detections.
        judged: candidates, as :func:`slam.evaluation.place_recognition.closures.judge_closures` returns them.
        truth: may hold no pose.
        protocol: the thresholds.
    """
    missing: list[str] = []
    errors: dict[str, _Errors | None] = {}
    T_map_world = _tie_first(graph, truth, protocol)
    if graph is None or T_map_world is None:
        missing.append("poses and landmarks: no truth at the first keyframe, which fixes the map")
    else:
        errors["pose"] = _pose_errors(graph, T_map_world, truth, protocol)
        if map_est is not None and map_gt is not None and matches is not None:
            errors["landmark"] = _landmark_errors(map_est, map_gt, matches, T_map_world)
    if judged is not None:
        errors["closure"] = _closure_errors(judged, truth, protocol)
    parts: dict[str, Consistency] = {}
    for kind, measured in errors.items():
        for prefix, axes in (("", slice(None)), ("planar_", IN_PLANE[kind])):
            if measured is not None:
                part = measure_consistency(measured[0][:, axes], measured[1][:, axes][:, :, axes])
                parts |= {f"{prefix}{kind}": part} if part is not None else {}
    if T_map_world is not None and "pose" not in parts:
        missing.append("poses: no covariances of keyframes with truth in the log (/slam/graph)")
    if T_map_world is not None and "landmark" not in parts:
        missing.append("landmarks: no confirmed one with a covariance, of an object, by the truth of detections")
    if "closure" not in parts:
        missing.append("closures: no accepted true one with a covariance")
    return parts, "; ".join(missing)


def describe_calibration(parts: Mapping[str, Consistency], probability: float) -> dict[str, float | None]:
    """Coverage of the regions with that ``probability``, NEES and number of errors, by the keys of the JSON."""
    figures: dict[str, float | None] = {}
    for name in CALIBRATED:
        part = parts.get(name)
        figures[f"{name}_coverage"] = part.coverage(probability) if part else None
        figures[f"{name}_nees"] = part.nees if part else None
        figures[f"{name}_count"] = part.count if part else 0
    return figures


def pose_errors(T_est: FloatArray, T_gt: FloatArray) -> FloatArray:
    """Errors (N, 6) of poses (N, 4, 4), rotation [rad] first: ``T_gt = T_est Exp(error)``, about the axes of the body.

    It is what the covariances of poses and closures are about.
    """
    return RigidTransform.from_matrix(invert(T_est) @ T_gt).as_exp_coords()


def _tie_first(graph: FactorGraphRecord | None, truth: PoseSeries, protocol: Protocol) -> FloatArray | None:
    """``T_map_world`` (4, 4) that lays the truth of the first keyframe on its estimate; None where it has no truth."""
    if graph is None or len(graph.keyframe_ids) == 0:
        return None
    known, T_world_body = find_true_poses(truth, graph.keyframe_stamps_ns[:1], max_gap_s=protocol.max_truth_gap_s)
    return invert(T_world_body[0] @ invert(graph.T_map_body[0])) if known[0] else None


def _pose_errors(
    graph: FactorGraphRecord, T_map_world: FloatArray, truth: PoseSeries, protocol: Protocol
) -> _Errors | None:
    if len(graph.pose_covariances) == 0:
        return None
    known, T_world_body = find_true_poses(truth, graph.keyframe_stamps_ns, max_gap_s=protocol.max_truth_gap_s)
    known[0] = False
    return pose_errors(graph.T_map_body[known], T_map_world @ T_world_body[known]), graph.pose_covariances[known]


def _landmark_errors(
    map_est: ObjectMapRecord, map_gt: ObjectMapRecord, matches: LandmarkMatches, T_map_world: FloatArray
) -> _Errors:
    matched = matches.object_rows >= 0
    rows = matches.landmark_rows[matched]
    errors = map_est.positions[rows] - apply(T_map_world, map_gt.positions[matches.object_rows[matched]])
    return errors, map_est.covariances[rows]


def _closure_errors(judged: pd.DataFrame, truth: PoseSeries, protocol: Protocol) -> _Errors | None:
    chosen = judged[judged["accepted"] & judged["true"]]
    chosen = chosen[[record.covariance is not None for record in chosen["record"]]]
    if chosen.empty:
        return None
    T_world_reference, T_world_query = (
        find_true_poses(truth, chosen[name].to_numpy(), max_gap_s=protocol.max_truth_gap_s)[1]
        for name in ("reference_stamp_ns", "stamp_ns")
    )
    T_reference_query = np.array([record.T_reference_query for record in chosen["record"]])
    covariances = np.array([record.covariance for record in chosen["record"]])
    return pose_errors(T_reference_query, invert(T_world_reference) @ T_world_query), covariances
