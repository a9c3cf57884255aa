"""Errors of a trajectory against the truth: absolute after alignment, and relative over stretches of path."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from slam.common.arrays import FloatArray
from slam.common.errors import EvaluationError
from slam.common.geometry import apply, invert, rotation_angle_rad, travelled_m
from slam.evaluation.inputs.synchronization import PoseSeries, SynchronizedPoses, synchronize
from slam.evaluation.metrics.alignment import Alignment, align_path, align_yaw_translation

KITTI_LENGTHS_M = (100.0, 200.0, 300.0, 400.0, 500.0, 600.0, 700.0, 800.0)
KITTI_START_STEP = 10


@dataclass(frozen=True, slots=True)
class ErrorStatistics:
    """Summary of ``count`` >= 1 distances in metres."""

    count: int
    rmse_m: float
    mean_m: float
    median_m: float
    p95_m: float
    max_m: float


@dataclass(frozen=True, slots=True)
class RelativeError:
    """Mean drift over stretches of ``length_m``; None where the drive has no such stretch.

    ``mean_stretch_m`` is what the stretches really measure: they end at a pose, so they are a little longer.
    """

    length_m: float
    stretch_count: int
    mean_stretch_m: float | None
    translation_percent: float | None
    rotation_deg_per_100m: float | None


@dataclass(frozen=True, slots=True)
class RelativeErrors:
    """One row a length, and the mean over all stretches of all lengths (not the mean of the rows)."""

    rows: tuple[RelativeError, ...]
    stretch_count: int
    translation_percent: float | None
    rotation_deg_per_100m: float | None


@dataclass(frozen=True, slots=True, eq=False)
class TrajectoryErrors:
    """All errors of one trajectory; ``length_m`` is the true path that was compared.

    ``relative`` holds KITTI's lengths; ``short_relative`` short stretches, divided by what they really measure.
    The counts say how many estimated poses were compared, how many had no truth (outside, gap), and what was repaired.
    ``absolute_yaw``: after the alignment of yaw and translation alone; None where the path does not move in the plane.
    """

    absolute: ErrorStatistics
    relative: RelativeErrors
    short_relative: RelativeErrors
    alignment: Alignment
    length_m: float
    duration_s: float
    pose_count: int
    outside_count: int
    gap_count: int
    duplicate_count: int
    disordered_count: int
    absolute_yaw: ErrorStatistics | None = None


def summarize(errors_m: FloatArray) -> ErrorStatistics:
    """Statistics of distances (N,), metres.

    Raises:
        EvaluationError: N = 0, or a value is not finite.
    """
    if len(errors_m) == 0 or not np.isfinite(errors_m).all():
        raise EvaluationError(f"{len(errors_m)} errors, not all finite or none at all: no statistics")
    return ErrorStatistics(
        count=len(errors_m),
        rmse_m=float(np.sqrt(np.mean(errors_m**2))),
        mean_m=float(np.mean(errors_m)),
        median_m=float(np.median(errors_m)),
        p95_m=float(np.percentile(errors_m, 95.0)),
        max_m=float(np.max(errors_m)),
    )


def compute_absolute_error(
    positions_est: FloatArray, positions_gt: FloatArray, alignment: Alignment
) -> ErrorStatistics:
    """Absolute trajectory error: distances between the aligned estimate and the truth.

    Source: Sturm et al., "A benchmark for the evaluation of RGB-D SLAM systems", IROS 2012, eq. (3), translation part.

    Args:
        positions_est: (N, 3) metres, map frame.
        positions_gt: (N, 3) metres, world frame, of the same times.
        alignment: as :func:`slam.evaluation.metrics.alignment.align_path` finds it.

    Raises:
        EvaluationError: N = 0 or a value that is not finite.
    """
    return summarize(np.linalg.norm(apply(alignment.T_world_map, positions_est) - positions_gt, axis=1))


def compute_relative_errors(
    T_map_body_est: FloatArray,
    T_world_body_gt: FloatArray,
    *,
    lengths_m: Sequence[float] = KITTI_LENGTHS_M,
    start_step: int = KITTI_START_STEP,
    divide_by: Literal["nominal", "travelled"] = "nominal",
) -> RelativeErrors:
    """Relative pose error over stretches of path, as the KITTI odometry benchmark defines it. No alignment is needed.

    From every ``start_step``-th pose a stretch reaches to the first pose more than ``length_m`` further along the true
    path. Its error is ``(T_est_first^-1 T_est_last)^-1 (T_gt_first^-1 T_gt_last)``; the translation and the angle are
    divided by the nominal length (KITTI) or by the path that was really travelled, which matters where poses are
    sparse compared with the length.

    Source: Geiger et al., "Are we ready for autonomous driving?", CVPR 2012; development kit, evaluate_odometry.cpp.

    Args:
        T_map_body_est: (N, 4, 4), metres; N may be 0.
        T_world_body_gt: (N, 4, 4), metres, of the same times.
        lengths_m: positive lengths of the stretches.
        start_step: number of poses from one start to the next, >= 1.
        divide_by: "nominal" is KITTI's definition.

    Returns:
        A row a length; lengths that the drive does not reach have no stretches and None as errors.

    Raises:
        EvaluationError: the two differ in length, or a parameter is out of range.
    """
    if len(T_map_body_est) != len(T_world_body_gt):
        raise EvaluationError(f"{len(T_map_body_est)} estimated poses against {len(T_world_body_gt)} true ones")
    if start_step < 1 or any(length <= 0 for length in lengths_m):
        raise EvaluationError(f"stretches need start_step >= 1 and lengths > 0, got {start_step} and {lengths_m}")
    path_m = travelled_m(T_world_body_gt)
    starts = np.arange(0, len(path_m), start_step)
    rows: list[RelativeError] = []
    translations: list[FloatArray] = []
    rotations: list[FloatArray] = []
    for length in lengths_m:
        ends = np.searchsorted(path_m, path_m[starts] + length, side="right")
        first, last = starts[ends < len(path_m)], ends[ends < len(path_m)]
        T_step_est = invert(T_map_body_est[first]) @ T_map_body_est[last]
        T_step_gt = invert(T_world_body_gt[first]) @ T_world_body_gt[last]
        T_error = invert(T_step_est) @ T_step_gt
        stretches = path_m[last] - path_m[first]
        divisor = stretches if divide_by == "travelled" else np.full(len(first), length)
        translations.append(np.linalg.norm(T_error[:, :3, 3], axis=1) / divisor)
        rotations.append(rotation_angle_rad(T_error) / divisor)
        rows.append(RelativeError(length, len(first), _mean(stretches), *_mean_drift(translations[-1], rotations[-1])))
    all_translations = np.concatenate(translations) if translations else np.zeros(0)
    all_rotations = np.concatenate(rotations) if rotations else np.zeros(0)
    return RelativeErrors(tuple(rows), len(all_translations), *_mean_drift(all_translations, all_rotations))


def evaluate_trajectory(
    estimate: PoseSeries,
    truth: PoseSeries,
    *,
    max_gap_s: float,
    lengths_m: Sequence[float] = KITTI_LENGTHS_M,
    short_lengths_m: Sequence[float] = (1.0, 10.0),
    start_step: int = KITTI_START_STEP,
) -> TrajectoryErrors:
    """All errors of one trajectory of the body against its truth.

    Raises:
        EvaluationError: no common time, a single common pose, or no motion; never a NaN.
    """
    poses = synchronize(estimate, truth, max_gap_s=max_gap_s)
    alignment = align_path(poses.positions_est, poses.positions_gt)
    both = (poses.T_map_body_est, poses.T_world_body_gt)
    return TrajectoryErrors(
        absolute=compute_absolute_error(poses.positions_est, poses.positions_gt, alignment),
        relative=compute_relative_errors(*both, lengths_m=lengths_m, start_step=start_step),
        short_relative=compute_relative_errors(
            *both, lengths_m=short_lengths_m, start_step=start_step, divide_by="travelled"
        ),
        alignment=alignment,
        length_m=float(travelled_m(poses.T_world_body_gt)[-1]),
        duration_s=int(poses.stamps_ns[-1] - poses.stamps_ns[0]) * 1e-9,
        pose_count=len(poses.stamps_ns),
        outside_count=poses.outside_count,
        gap_count=poses.gap_count,
        duplicate_count=estimate.duplicate_count + truth.duplicate_count,
        disordered_count=estimate.disordered_count + truth.disordered_count,
        absolute_yaw=_compute_yaw_error(poses),
    )


def _compute_yaw_error(poses: SynchronizedPoses) -> ErrorStatistics | None:
    try:
        alignment = align_yaw_translation(poses.positions_est, poses.positions_gt)
    except EvaluationError:
        return None
    return compute_absolute_error(poses.positions_est, poses.positions_gt, alignment)


def _mean(values: FloatArray) -> float | None:
    return float(np.mean(values)) if len(values) else None


def _mean_drift(translations: FloatArray, rotations: FloatArray) -> tuple[float | None, float | None]:
    """Mean of metres per metre as percent, and of radians per metre as degrees per 100 m."""
    if len(translations) == 0:
        return None, None
    return 100.0 * float(np.mean(translations)), 100.0 * float(np.rad2deg(np.mean(rotations)))
