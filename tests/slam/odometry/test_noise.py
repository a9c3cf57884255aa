"""The noise of a step of the odometry: a random walk by travel, by turning and by time."""

from dataclasses import replace

import numpy as np
import pytest

from slam.common.calibration import OdometryCalibration
from slam.odometry.noise import model_variances, step_covariance, step_variances
from slam.odometry.pose import OdometryPose
from tests.helpers.poses import motion_by, pose_at

SILENT = {
    "translation_sigma": 1e-6,
    "yaw_sigma": 1e-6,
    "yaw_sigma_by_turn": 0.0,
    "tilt_sigma": 1e-6,
    "min_translation_sigma_m": 1e-6,
    "min_rotation_sigma_rad": 1e-6,
}
"""Next to no noise; tests add that which they are about."""
ALL = OdometryCalibration(translation_sigma_by_time=0.02, yaw_sigma_by_time=0.003)
ONE = np.ones(2)
TRANSLATION, TILT, HEADING = range(3)


def pose(x: float = 0.0, *, yaw: float = 0.0, seconds: float = 0.0, travel_m: float | None = None) -> OdometryPose:
    return OdometryPose(round(seconds * 1e9), pose_at(x, yaw=yaw), x if travel_m is None else travel_m, 0, 1.0)


@pytest.mark.parametrize(
    ("setting", "sigma", "step", "amount", "entry"),
    [
        ("translation_sigma", 0.05, {"x": 7.0}, 7.0, TRANSLATION),
        ("translation_sigma_by_time", 0.03, {"seconds": 5.0}, 5.0, TRANSLATION),
        ("tilt_sigma", 0.002, {"x": 7.0}, 7.0, TILT),
        ("yaw_sigma", 0.01, {"x": 7.0}, 7.0, HEADING),
        ("yaw_sigma_by_turn", 0.02, {"yaw": 1.5}, 1.5, HEADING),
        ("yaw_sigma_by_turn", 0.02, {"yaw": -1.5}, 1.5, HEADING),
        ("yaw_sigma_by_time", 0.004, {"seconds": 5.0}, 5.0, HEADING),
    ],
)
def test_each_variance_grows_in_proportion_to_what_it_is_caused_by(setting, sigma, step, amount, entry):
    config = OdometryCalibration(**(SILENT | {setting: sigma}))
    variances = step_variances(pose(), pose(**step), config)
    assert variances[entry] == pytest.approx(sigma**2 * amount, rel=1e-3)
    assert np.delete(variances, entry).max() < 1e-9


def test_travel_that_came_back_counts_and_a_step_is_never_shorter_than_its_ends_are_apart():
    config = OdometryCalibration(**(SILENT | {"translation_sigma": 0.1}))
    there_and_back = step_variances(pose(), pose(0.0, travel_m=6.0), config)
    np.testing.assert_allclose(there_and_back[TRANSLATION], 0.01 * 6.0)
    jitter_not_counted = step_variances(pose(), pose(0.5, travel_m=0.0), config)
    np.testing.assert_allclose(jitter_not_counted[TRANSLATION], 0.01 * 0.5)


def test_standing_still_is_not_perfectly_certain():
    config = OdometryCalibration()
    expected = [config.min_translation_sigma_m**2, config.min_rotation_sigma_rad**2, config.min_rotation_sigma_rad**2]
    np.testing.assert_allclose(step_variances(pose(), pose(), config), expected)


def test_the_covariance_has_the_variances_on_its_diagonal_rotation_first():
    before, after = pose(), pose(3.0, yaw=0.5, seconds=2.0)
    translation, tilt, heading = step_variances(before, after, ALL)
    vertical = ALL.min_translation_sigma_m**2
    expected = np.diag([tilt, tilt, heading, translation, translation, vertical])
    np.testing.assert_allclose(step_covariance(before, after, ALL, ONE), expected, atol=1e-18)


def test_a_body_that_leans_errs_in_heading_about_the_vertical():
    before, after = pose(), pose(3.0)
    leaning = replace(after, T_odom_body=after.T_odom_body @ motion_by([0.7, 0.0, 0.0]))
    R = leaning.T_odom_body[:3, :3]
    upright, leant = step_covariance(before, after, ALL, ONE), step_covariance(before, leaning, ALL, ONE)
    up_body = R.T @ [0.0, 0.0, 1.0]
    _, tilt, heading = step_variances(before, leaning, ALL)
    assert up_body @ leant[:3, :3] @ up_body == pytest.approx(heading)
    np.testing.assert_allclose(leant[:3, :3], tilt * np.eye(3) + (heading - tilt) * np.outer(up_body, up_body))
    np.testing.assert_allclose(R @ leant[3:, 3:] @ R.T, upright[3:, 3:], atol=1e-12)


def test_variances_of_a_correction_are_added():
    before, after = pose(), pose(3.0)
    corrected = replace(after, corrected=np.array([0.5, 0.01, 0.02]))
    np.testing.assert_array_equal(model_variances(before, corrected, ALL), model_variances(before, after, ALL))
    more = step_variances(before, corrected, ALL) - step_variances(before, after, ALL)
    np.testing.assert_allclose(more, [0.5, 0.01, 0.02], atol=1e-12)


def test_factors_scale_what_the_model_says_and_not_the_corrections():
    before, after = pose(), replace(pose(3.0), corrected=np.array([0.5, 0.01, 0.02]))
    model = step_covariance(before, pose(3.0), ALL, ONE)
    more = step_covariance(before, after, ALL, np.array([4.0, 9.0])) - np.diag([1.0, 1.0, 9.0, 4.0, 4.0, 4.0]) * model
    np.testing.assert_allclose(more, np.diag([0.01, 0.01, 0.02, 0.5, 0.5, 0.5]), atol=1e-12)
