import numpy as np
import pytest

from slam.common.arrays import FloatArray
from slam.common.geometry import invert, transform_from_xyz_yaw, yaw_rad
from slam.simulation.config import OdometryConfig
from slam.simulation.simulation import drifting_odometry
from tests.helpers.poses import pose_at
from tests.slam.evaluation.drives import straight_path
from tests.slam.trajectory_check.drives import circle

STEP_M = 0.8
SEGMENT_STEPS = 125  # 100 m


def _segment_errors(config: OdometryConfig, *, segments: int = 2000) -> tuple[FloatArray, FloatArray]:
    """Error of each 100 m of a long straight drive: translation (S, 2) m, frame of its start, and heading (S,) rad."""
    T = drifting_odometry(straight_path(segments * SEGMENT_STEPS + 1, STEP_M), config, rng=np.random.default_rng(1))
    T_start_end = invert(T[:-1:SEGMENT_STEPS]) @ T[SEGMENT_STEPS::SEGMENT_STEPS]
    return T_start_end[:, :2, 3] - [100.0, 0.0], yaw_rad(T_start_end)


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def test_without_drift_it_is_the_true_motion_from_the_identity() -> None:
    T_world_body = pose_at(3.0, -4.0, yaw=0.3) @ circle()
    config = OdometryConfig(scale_drift_percent=0.0, heading_drift_deg_per_100m=0.0)
    T_odom_body = drifting_odometry(T_world_body, config, rng=np.random.default_rng(0))
    np.testing.assert_allclose(T_odom_body, invert(T_world_body[0]) @ T_world_body, atol=1e-9)


@pytest.mark.parametrize("correlation_m", [2.0, 20.0])
def test_length_error_over_100_m_is_the_configured_share(correlation_m: float) -> None:
    config = OdometryConfig(scale_drift_percent=2.0, scale_correlation_m=correlation_m, heading_drift_deg_per_100m=0.0)
    translation, heading = _segment_errors(config)
    # 2000 segments: the rms is known to 1.6 %, to 2.5 % where neighbours are correlated.
    assert _rms(translation[:, 0]) == pytest.approx(2.0, rel=0.08)
    assert _rms(translation[:, 1]) < 1e-6
    assert _rms(heading) < 1e-9


def test_heading_error_over_100_m_is_the_configured_one() -> None:
    translation, heading = _segment_errors(OdometryConfig(scale_drift_percent=0.0))
    assert np.rad2deg(_rms(heading)) == pytest.approx(0.5, rel=0.06)
    assert _rms(translation[:, 1]) == pytest.approx(100.0 * np.deg2rad(0.5) / np.sqrt(3.0), rel=0.06)


def test_scale_error_is_smooth_over_short_paths() -> None:
    T = drifting_odometry(straight_path(2000, STEP_M), OdometryConfig(), rng=np.random.default_rng(3))
    lengths = np.linalg.norm(np.diff(T[:, :2, 3], axis=0), axis=1) / STEP_M - 1.0
    correlation = np.corrcoef(lengths[1:], lengths[:-1])[0, 1]
    assert correlation == pytest.approx(np.exp(-STEP_M / 20.0), abs=0.02)


def test_nothing_drifts_while_the_body_stands_or_turns_on_the_spot() -> None:
    T_world_body = transform_from_xyz_yaw(np.ones((50, 3)) * [1.0, 1.0, 0.0], np.linspace(0.0, 3.0, 50))
    T = drifting_odometry(T_world_body, OdometryConfig(), rng=np.random.default_rng(0))
    np.testing.assert_allclose(T[:, :3, 3], 0.0, atol=1e-12)
    np.testing.assert_allclose(yaw_rad(T), np.linspace(0.0, 3.0, 50), atol=1e-12)


def test_one_drift_does_not_change_with_the_other() -> None:
    _, both = _segment_errors(OdometryConfig(), segments=5)
    _, alone = _segment_errors(OdometryConfig(scale_drift_percent=0.0), segments=5)
    np.testing.assert_allclose(both, alone, atol=1e-12)
