from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slam.common.errors import EvaluationError
from slam.common.geometry import make_transform, transform_from_xyz_yaw
from slam.evaluation.metrics.alignment import align_path
from slam.evaluation.metrics.trajectory import (
    compute_absolute_error,
    compute_relative_errors,
    evaluate_trajectory,
    summarize,
)
from tests.helpers.data import needs_kitti
from tests.slam.evaluation.drives import kitti_poses, series, straight_path, winding_path


def test_statistics_by_hand() -> None:
    statistics = summarize(np.array([3.0, 4.0, 0.0, 1.0]))
    assert statistics.rmse_m == pytest.approx(np.sqrt(26.0 / 4.0))
    assert (statistics.mean_m, statistics.median_m, statistics.max_m, statistics.count) == (2.0, 2.0, 4.0, 4)


def test_ate_by_hand() -> None:
    # The corners of a square, each pushed out by the same amount: no rigid motion makes that smaller.
    square = np.array([[1.0, 0, 0], [0, 1.0, 0], [-1.0, 0, 0], [0, -1.0, 0]])
    alignment = align_path(square, 1.5 * square)
    statistics = compute_absolute_error(square, 1.5 * square, alignment)
    assert (statistics.rmse_m, statistics.max_m) == (pytest.approx(0.5), pytest.approx(0.5))


def test_ate_is_invariant_under_rigid_motion() -> None:
    rng = np.random.default_rng(1)
    T_gt = winding_path(400)
    T_est = T_gt.copy()
    T_est[:, :3, 3] += np.cumsum(rng.normal(0.0, 0.1, (400, 3)), axis=0)
    before = evaluate_trajectory(series(T_est), series(T_gt), max_gap_s=1.0)
    motion = make_transform(Rotation.random(rng=rng).as_matrix(), np.array([500.0, -20.0, 9.0]))
    after = evaluate_trajectory(series(motion @ T_est), series(T_gt), max_gap_s=1.0)
    assert before.absolute.rmse_m > 0.1
    assert after.absolute.rmse_m == pytest.approx(before.absolute.rmse_m, rel=1e-9)
    assert after.relative.translation_percent == pytest.approx(before.relative.translation_percent, rel=1e-9)


def test_a_drift_of_scale_gives_that_relative_error() -> None:
    T_gt = straight_path(1001)
    errors = compute_relative_errors(straight_path(1001, step_m=1.01), T_gt)
    for row in errors.rows:
        # A stretch ends at the first pose beyond the length: 1 m further on.
        assert row.mean_stretch_m == pytest.approx(row.length_m + 1.0)
        assert row.translation_percent == pytest.approx(1.0 * (row.length_m + 1.0) / row.length_m, rel=1e-9)
        assert row.rotation_deg_per_100m == pytest.approx(0.0, abs=1e-9)
    travelled = compute_relative_errors(
        straight_path(1001, step_m=1.01), T_gt, lengths_m=(1.0, 10.0), divide_by="travelled"
    )
    assert [row.translation_percent for row in travelled.rows] == [pytest.approx(1.0), pytest.approx(1.0)]


def test_a_drift_of_heading_gives_that_relative_error() -> None:
    drift = np.deg2rad(0.02)  # a metre
    count, length = 1001, 100.0
    s = np.arange(count, dtype=float)
    heading = drift * s
    xyz = np.stack([np.sin(heading), 1.0 - np.cos(heading), 0.0 * s], axis=1) / drift
    errors = compute_relative_errors(transform_from_xyz_yaw(xyz, heading), straight_path(count), lengths_m=(length,))
    angle = drift * 101.0
    chord = np.hypot(101.0 - np.sin(angle) / drift, (1.0 - np.cos(angle)) / drift)
    assert errors.rows[0].rotation_deg_per_100m == pytest.approx(0.02 * 101.0, rel=1e-9)
    assert errors.rows[0].translation_percent == pytest.approx(chord, rel=1e-6)


def test_relative_error_averages_over_stretches() -> None:
    errors = compute_relative_errors(straight_path(301, step_m=1.02), straight_path(301))
    counts = [row.stretch_count for row in errors.rows]
    assert counts == [20, 10, 0, 0, 0, 0, 0, 0]
    assert [row.translation_percent for row in errors.rows[2:]] == [None] * 6
    expected = (20 * 2.0 * 1.01 + 10 * 2.0 * 1.005) / 30
    assert errors.translation_percent == pytest.approx(expected)


def test_short_drive_has_only_absolute_error() -> None:
    errors = evaluate_trajectory(series(winding_path(60)), series(winding_path(60)), max_gap_s=1.0)
    assert errors.relative.translation_percent is None
    assert errors.absolute.rmse_m == pytest.approx(0.0, abs=1e-9)


def test_a_straight_drive_is_flagged_and_still_measured() -> None:
    T_est = straight_path(200)
    T_est[:, 1, 3] += 0.05 * (-1.0) ** np.arange(200)
    errors = evaluate_trajectory(series(T_est), series(straight_path(200)), max_gap_s=1.0)
    assert errors.alignment.kind == "yaw_translation"
    assert errors.alignment.note
    assert errors.absolute.rmse_m == pytest.approx(0.05, rel=1e-3)


def test_one_pose_and_a_standstill_are_errors() -> None:
    with pytest.raises(EvaluationError, match="at least 2"):
        evaluate_trajectory(series(straight_path(1)), series(straight_path(1)), max_gap_s=1.0)
    with pytest.raises(EvaluationError, match="moves"):
        evaluate_trajectory(series(np.tile(np.eye(4), (9, 1, 1))), series(straight_path(9)), max_gap_s=1.0)


def test_lengths_and_steps_out_of_range_are_refused() -> None:
    T = straight_path(10)
    with pytest.raises(EvaluationError, match="start_step"):
        compute_relative_errors(T, T, start_step=0)
    with pytest.raises(EvaluationError, match="lengths"):
        compute_relative_errors(T, T, lengths_m=(0.0,))
    with pytest.raises(EvaluationError, match="against"):
        compute_relative_errors(T, T[:5])


@needs_kitti
def test_the_published_errors_of_s_ptam_on_kitti_00() -> None:
    estimate, truth = (series(kitti_poses(f"KITTI_00_{name}.txt")) for name in ("SPTAM", "gt"))
    errors = evaluate_trajectory(estimate, truth, max_gap_s=1.0)
    assert errors.absolute.rmse_m == pytest.approx(3.74, abs=0.005)
    assert errors.relative.translation_percent == pytest.approx(1.49, abs=0.005)
    assert errors.relative.rotation_deg_per_100m == pytest.approx(0.56, abs=0.005)
    assert errors.length_m == pytest.approx(3724.0, abs=1.0)


def test_the_error_by_yaw_sees_a_tilt_that_se3_aligns_away() -> None:
    T_gt = winding_path(400)
    tilt = make_transform(Rotation.from_euler("y", 5.0, degrees=True).as_matrix(), np.array([3.0, 4.0, 5.0]))
    turn = transform_from_xyz_yaw(np.array([3.0, 4.0, 5.0]), 1.0)
    tilted, turned = (evaluate_trajectory(series(T @ T_gt), series(T_gt), max_gap_s=1.0) for T in (tilt, turn))
    assert tilted.absolute.rmse_m == pytest.approx(0.0, abs=1e-9)
    assert turned.absolute_yaw.rmse_m == pytest.approx(0.0, abs=1e-9)
    spread_m = np.std(T_gt[:, 0, 3])
    assert tilted.absolute_yaw.rmse_m == pytest.approx(np.sin(np.deg2rad(5.0)) * spread_m, rel=0.05)
