"""The prior of a pose: what the odometry says, and what is left where it may have failed."""

import numpy as np
import pytest

from slam.loop_closure.verification import PosePrior
from tests.helpers.poses import pose_at

COVARIANCE = np.diag([1e-4, 1e-4, 0.02**2, 0.2**2, 0.2**2, 0.1**2])
VOLUME = (2.0 * np.pi) ** 1.5 * 0.02 * 0.2 * 0.2
T_PREDICTED = pose_at(30.0, -4.0, z=1.0, yaw=2.0)


def prior(*, sigma_m: float = 1.0, sigma_rad: float = 0.05, failed: float = 1e-6, area_m2: float = 1e5) -> PosePrior:
    return PosePrior(T_PREDICTED, sigma_m, sigma_rad, failed, area_m2)


def test_without_odometry_it_is_the_share_of_the_area_that_the_measurement_covers():
    lost = prior(sigma_m=np.inf, sigma_rad=np.inf)
    for T in (T_PREDICTED, T_PREDICTED @ pose_at(500.0, yaw=3.0)):
        assert lost.log_mass(T, COVARIANCE) == pytest.approx(np.log(VOLUME / (2.0 * np.pi * 1e5)))


def test_at_the_predicted_pose_it_is_the_ratio_of_the_volumes():
    spread = np.sqrt((1.0**2 + 0.2**2) ** 2 * (0.05**2 + 0.02**2))
    expected = np.log(VOLUME / ((2.0 * np.pi) ** 1.5 * spread))
    assert prior().log_mass(T_PREDICTED, COVARIANCE) == pytest.approx(expected, abs=1e-3)


@pytest.mark.parametrize(
    ("moved", "squares"),
    [
        (pose_at(3.0), 9.0 / 1.04),
        (pose_at(0.0, -3.0), 9.0 / 1.04),
        (pose_at(yaw=0.1), 0.01 / (0.05**2 + 0.02**2)),
        (pose_at(z=50.0), 0.0),
    ],
)
def test_it_falls_with_the_distance_from_the_prediction_in_the_plane_and_in_heading(moved, squares):
    fall = prior().log_mass(T_PREDICTED, COVARIANCE) - prior().log_mass(T_PREDICTED @ moved, COVARIANCE)
    assert fall == pytest.approx(0.5 * squares, abs=0.01)


def test_far_from_the_prediction_only_a_failure_of_the_odometry_is_left():
    far, lost = T_PREDICTED @ pose_at(300.0), prior(sigma_m=np.inf).log_mass(T_PREDICTED, COVARIANCE)
    for failed in (1e-3, 1e-6):
        assert prior(failed=failed).log_mass(far, COVARIANCE) == pytest.approx(lost + np.log(failed))


def test_it_is_a_probability():
    assert prior(sigma_m=1e-6, sigma_rad=1e-6).log_mass(T_PREDICTED, COVARIANCE) <= 0.0
    assert prior(sigma_m=np.inf, area_m2=1e-6).log_mass(T_PREDICTED, COVARIANCE) == 0.0
