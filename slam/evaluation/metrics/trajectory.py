"""Errors of a trajectory against the truth: absolute after alignment, and relative over stretches of path."""

import numpy as np

from logs.records import frozen
from slam.common.arrays import FloatArray
from slam.common.geometry import invert, rotation_angle_rad, step_lengths, travelled_m
from slam.evaluation.inputs.protocol import Protocol
from slam.evaluation.inputs.synchronization import PoseSeries, synchronize
from slam.evaluation.metrics.alignment import align_path, aligned_errors_m


@frozen
class TrajectoryErrors:
    """Errors of one trajectory; ``length_m``, ``duration_s`` and ``pose_count`` are of the part that has a truth, the
    length without gaps of the truth and without kidnappings.

    ``ate_m`` is the RMSE of the positions, aligned by ``T_world_map`` (4, 4). The relative errors (``rpe_...``) are
    None where the drive is shorter than the stretches.
    """

    ate_m: float
    median_m: float
    p95_m: float
    max_m: float
    rpe_translation_percent: float | None
    rpe_rotation_deg_per_100m: float | None
    T_world_map: FloatArray
    length_m: float
    duration_s: float
    pose_count: int


def evaluate_trajectory(estimate: PoseSeries, truth: PoseSeries, *, kidnapping_m: float = np.inf) -> TrajectoryErrors:
    """All errors of one trajectory of the body against its truth, in which longer steps are kidnappings.

    The absolute error is that of Sturm et al., "A benchmark for the evaluation of RGB-D SLAM systems", IROS 2012, eq.
    (3), translation part.

    Raises:
        EvaluationError: no common time, a single common pose, or no motion; never a NaN.
    """
    est, gt = synchronize(estimate, truth)
    T_world_map = align_path(est.positions, gt.positions)
    errors_m = aligned_errors_m(T_world_map, est.positions, gt.positions)
    steps_m = step_lengths(gt.positions)
    is_driven = (np.diff(gt.stamps_ns) <= Protocol().max_truth_gap_s * 1e9) & (steps_m < kidnapping_m)
    translation_percent, rotation_deg_per_100m = compute_relative_error(est.T_world_body, gt.T_world_body)
    return TrajectoryErrors(
        ate_m=float(np.sqrt(np.mean(errors_m**2))),
        median_m=float(np.median(errors_m)),
        p95_m=float(np.percentile(errors_m, 95.0)),
        max_m=float(np.max(errors_m)),
        rpe_translation_percent=translation_percent,
        rpe_rotation_deg_per_100m=rotation_deg_per_100m,
        T_world_map=T_world_map,
        length_m=float(steps_m[is_driven].sum()),
        duration_s=np.ptp(gt.stamps_ns) * 1e-9,
        pose_count=len(gt),
    )


def compute_relative_error(
    T_map_body_est: FloatArray, T_world_body_gt: FloatArray
) -> tuple[float | None, float | None]:
    """Relative pose error as the KITTI odometry benchmark defines it: percent, and degrees per 100 m.

    From every tenth pose a stretch reaches to the first pose more than a length, 100 m to 800 m, further along the true
    path. Its error is ``(T_est_first^-1 T_est_last)^-1 (T_gt_first^-1 T_gt_last)``, divided by the nominal length; the
    mean is over all stretches of all lengths. No alignment is needed.

    Source: Geiger et al., "Are we ready for autonomous driving?", CVPR 2012; development kit, evaluate_odometry.cpp.

    Args:
        T_map_body_est: (N, 4, 4), metres.
        T_world_body_gt: (N, 4, 4), metres, of the same times.

    Returns:
        None, None where the drive has no such stretch.
    """
    path_m = travelled_m(T_world_body_gt[:, :3, 3])
    starts, lengths = (
        each.ravel() for each in np.meshgrid(np.arange(0, len(path_m), 10), np.arange(100.0, 801.0, 100.0))
    )
    ends = np.searchsorted(path_m, path_m[starts] + lengths, side="right")
    is_inside = ends < len(path_m)
    if not is_inside.any():
        return None, None
    first, last, divisor = starts[is_inside], ends[is_inside], lengths[is_inside]
    T_step_est = invert(T_map_body_est[first]) @ T_map_body_est[last]
    T_step_gt = invert(T_world_body_gt[first]) @ T_world_body_gt[last]
    T_error = invert(T_step_est) @ T_step_gt
    translation = np.mean(np.linalg.norm(T_error[:, :3, 3], axis=1) / divisor)
    return 100.0 * float(translation), 100.0 * float(np.rad2deg(np.mean(rotation_angle_rad(T_error) / divisor)))
