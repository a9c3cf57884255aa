"""The filter of each landmark, against samples of the odometry's errors and against the textbook's formula."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slam.frontend.landmark_filter import predict_covariances, update_positions
from tests.logs.examples import random_covariance

STEP_VARIANCES = np.array([0.09, 0.006, 0.018]) ** 2
"""Of a step: of each coordinate [m^2], of roll and pitch [rad^2], of the heading [rad^2]."""
SAMPLES = 200_000


@pytest.mark.parametrize("offset", [(12.0, -7.0, 3.0), (0.0, 20.0, 0.0), (0.0, 0.0, 0.0)])
def test_the_prediction_is_the_spread_of_many_erroneous_steps(offset):
    rng = np.random.default_rng(3)
    before = np.diag([0.02, 0.05, 0.01])
    translation, tilt, heading = np.sqrt(STEP_VARIANCES)
    offset = np.array(offset)
    landmark = offset + rng.multivariate_normal(np.zeros(3), before, SAMPLES)
    turn = Rotation.from_rotvec(rng.normal(scale=[tilt, tilt, heading], size=(SAMPLES, 3)))
    moved = turn.apply(landmark) + rng.normal(scale=translation, size=(SAMPLES, 3))
    predicted = predict_covariances(before[None], offset[None], STEP_VARIANCES)[0]
    sampled = np.cov(moved, rowvar=False)
    np.testing.assert_allclose(predicted, sampled, atol=0.015 * np.trace(sampled))
    assert np.trace(predicted) > 1.05 * np.trace(before)


def test_a_step_without_noise_blurs_nothing_and_one_with_noise_sharpens_nothing():
    rng = np.random.default_rng(0)
    P = np.stack([random_covariance(rng, 3) for _ in range(5)])
    offsets = rng.normal(scale=20.0, size=(5, 3))
    np.testing.assert_array_equal(predict_covariances(P, offsets, np.zeros(3)), P)
    grown = predict_covariances(P, offsets, STEP_VARIANCES) - P
    assert np.linalg.eigvalsh(grown).min() > 0.0


def test_the_update_is_the_textbooks():
    rng = np.random.default_rng(1)
    x, z = rng.normal(size=(2, 8, 3))
    P = np.stack([random_covariance(rng, 3) for _ in range(8)])
    R = np.stack([random_covariance(rng, 3) for _ in range(8)])
    fused, P_fused = update_positions(x, P, z, R)
    for i in range(8):
        # Joseph's form with H = I; Bar-Shalom et al. 2001, 5.2.3.
        K = P[i] @ np.linalg.inv(P[i] + R[i])
        I_KH = np.eye(3) - K
        np.testing.assert_allclose(fused[i], x[i] + K @ (z[i] - x[i]), atol=1e-12)
        np.testing.assert_allclose(P_fused[i], I_KH @ P[i] @ I_KH.T + K @ R[i] @ K.T, atol=1e-12)


def test_many_rounds_leave_the_covariance_symmetric_and_positive_definite():
    rng = np.random.default_rng(2)
    x, P = np.zeros((3, 3)), np.stack([np.diag([100.0, 1e-4, 1.0])] * 3)
    for _ in range(500):
        P = predict_covariances(P, rng.normal(scale=30.0, size=(3, 3)), rng.uniform(0, 0.2) * STEP_VARIANCES)
        z = rng.normal(scale=0.1, size=(3, 3))
        x, P = update_positions(x, P, z, np.stack([np.diag([1e-6, 4.0, 0.01])] * 3))
        np.testing.assert_array_equal(P, np.swapaxes(P, 1, 2))
        assert np.linalg.eigvalsh(P).min() > 0.0
        assert np.isfinite(x).all()


def test_the_error_is_as_large_as_the_filter_says():
    """Squared errors in units of the filter's own covariance average to the three degrees of freedom."""
    rng = np.random.default_rng(4)
    count = 4000
    R = random_covariance(rng, 3)
    x = rng.multivariate_normal(np.zeros(3), R, count)
    P = np.tile(R, (count, 1, 1))
    for _ in range(5):
        x, P = update_positions(x, P, rng.multivariate_normal(np.zeros(3), R, count), np.tile(R, (count, 1, 1)))
    squared = np.einsum("ni,ni->n", x, np.linalg.solve(P, x[..., None])[..., 0])
    assert squared.mean() == pytest.approx(3.0, abs=0.15)


def test_no_landmarks():
    none, no_P = np.zeros((0, 3)), np.zeros((0, 3, 3))
    assert predict_covariances(no_P, none, STEP_VARIANCES).shape == (0, 3, 3)
    fused, P = update_positions(none, no_P, none, no_P)
    assert fused.shape == (0, 3)
    assert P.shape == (0, 3, 3)
