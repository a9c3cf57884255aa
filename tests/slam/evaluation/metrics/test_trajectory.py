import numpy as np
import pytest

from slam.common.geometry import transform_from_xyz_yaw
from slam.evaluation.metrics.trajectory import compute_relative_error, evaluate_trajectory
from tests.helpers.data import needs_kitti
from tests.slam.evaluation.drives import kitti_poses, series, straight_path, winding_path


def test_statistics_of_absolute_error_by_hand() -> None:
    # The corners of a square, pushed out or pulled in: no rigid motion makes that smaller.
    corners = np.array([[1.0, 0, 0], [0, 1.0, 0], [-1.0, 0, 0], [0, -1.0, 0]])
    T_gt, T_est = np.tile(np.eye(4), (4, 1, 1)), np.tile(np.eye(4), (4, 1, 1))
    T_gt[:, :3, 3], T_est[:, :3, 3] = corners * [[1.5], [1.1], [1.5], [1.1]], corners
    errors = evaluate_trajectory(series(T_est), series(T_gt))
    assert errors.ate_m == pytest.approx(np.sqrt((0.5**2 + 0.1**2) / 2.0))
    assert (errors.median_m, errors.max_m, errors.p95_m) == pytest.approx((0.3, 0.5, 0.5))
    assert errors.pose_count == 4


def test_relative_error_averages_drift_of_scale_over_stretches() -> None:
    errors = compute_relative_error(straight_path(301, step_m=1.02), straight_path(301))
    # A stretch ends at the first pose beyond the length, 1 m further on: 20 stretches of 100 m, and 10 of 200 m.
    assert errors == pytest.approx(((20 * 2.0 * 1.01 + 10 * 2.0 * 1.005) / 30, 0.0), abs=1e-9)


def test_drift_of_heading_gives_that_relative_error() -> None:
    drift = np.deg2rad(0.02)  # a metre
    s = np.arange(200, dtype=float)  # stretches of 100 m alone
    heading = drift * s
    xyz = np.stack([np.sin(heading), 1.0 - np.cos(heading), 0.0 * s], axis=1) / drift
    errors = compute_relative_error(transform_from_xyz_yaw(xyz, heading), straight_path(200))
    angle = drift * 101.0
    chord = np.hypot(101.0 - np.sin(angle) / drift, (1.0 - np.cos(angle)) / drift)
    assert errors == pytest.approx((chord, 0.02 * 101.0), rel=1e-6)


def test_short_drive_has_only_absolute_error() -> None:
    errors = evaluate_trajectory(series(winding_path(60)), series(winding_path(60)))
    assert errors.rpe_translation_percent is errors.rpe_rotation_deg_per_100m is None
    assert errors.ate_m == pytest.approx(0.0, abs=1e-9)


@needs_kitti
def test_published_errors_of_s_ptam_on_kitti_00() -> None:
    estimate, truth = (series(kitti_poses(f"KITTI_00_{name}.txt")) for name in ("SPTAM", "gt"))
    errors = evaluate_trajectory(estimate, truth)
    # As evo 1.38.1 computes them: evo_ape kitti KITTI_00_gt.txt KITTI_00_SPTAM.txt --align
    assert errors.ate_m == pytest.approx(3.7385, abs=1e-3)
    assert errors.rpe_translation_percent == pytest.approx(1.49, abs=0.005)
    assert errors.rpe_rotation_deg_per_100m == pytest.approx(0.56, abs=0.005)
    assert errors.length_m == pytest.approx(3724.0, abs=1.0)
