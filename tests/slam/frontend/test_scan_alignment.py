"""A scan aligned with the landmarks around, from a pose that is off."""

from __future__ import annotations

import numpy as np
import pytest

from slam.common.arrays import FloatArray
from slam.common.calibration import ObjectCalibration
from slam.common.geometry import apply, invert, transform_from_xyz_yaw, yaw_rad
from slam.frontend.active_landmarks import Prediction
from slam.frontend.continuity import scan_log_likelihood_ratio
from slam.frontend.scan_alignment import Alignment, align_scan

CONFIG = ObjectCalibration()
ORIGIN = np.array([30.0, -10.0, 0.0])
NOISE_M = 0.05
OBJECTS = 15


def scene(off: FloatArray, seed: int, strangers: int = 0) -> tuple[FloatArray, FloatArray, Prediction, FloatArray]:
    """Detections as seen from a pose that is ``off`` (4, 4), their covariances, labels and the landmarks."""
    rng = np.random.default_rng(seed)
    landmarks = ORIGIN + np.column_stack([rng.uniform(-25, 25, (OBJECTS, 2)), np.zeros(OBJECTS)])
    seen = apply(off, landmarks + rng.normal(0.0, NOISE_M, landmarks.shape))
    seen[:strangers, :2] = ORIGIN[:2] + rng.uniform(-25, 25, (strangers, 2))
    covariances = np.tile(NOISE_M**2 * np.eye(3), (OBJECTS, 1, 1))
    return seen, covariances, Prediction(landmarks, covariances), np.ones((OBJECTS, 1))


def turned(shift: tuple[float, float], angle_rad: float) -> FloatArray:
    """A shift and a turn about the robot."""
    at = transform_from_xyz_yaw(ORIGIN, 0.0)
    return np.asarray(at @ transform_from_xyz_yaw(np.array([*shift, 0.0]), angle_rad) @ invert(at))


def align(off: FloatArray, seed: int, sigmas: tuple[float, float], strangers: int = 0) -> Alignment:
    seen, covariances, predicted, beliefs = scene(off, seed, strangers)
    labels = np.zeros(OBJECTS, dtype=np.int64)
    return align_scan(seen, covariances, labels, predicted, beliefs, CONFIG, origin=ORIGIN, sigmas=np.array(sigmas))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("shift", "angle_rad"), [((0.0, 0.0), 0.0), ((0.6, -0.4), 0.0), ((0.2, 0.3), -0.06)])
def test_the_correction_undoes_what_the_pose_is_off_by(seed, shift, angle_rad):
    off = turned(shift, angle_rad)
    left = align(off, seed, (0.5, 0.05), strangers=3).T_correction @ off
    np.testing.assert_allclose(apply(left, ORIGIN[None])[0], ORIGIN, atol=0.08)
    assert float(yaw_rad(left)) == pytest.approx(0.0, abs=0.01)


def test_the_variances_are_those_of_the_corrections():
    errors, found = [], align(turned((0.0, 0.0), 0.0), 0, (0.5, 0.05))
    for seed in range(40):
        off = turned((0.3, 0.2), 0.02)
        left = align(off, seed, (0.5, 0.05)).T_correction @ off
        errors.append([*(apply(left, ORIGIN[None])[0] - ORIGIN)[:2], float(yaw_rad(left))])
    rms = np.sqrt(np.mean(np.square(errors), axis=0))
    assert 0.5 < rms[0] / np.sqrt(found.variances[0]) < 2.0
    assert 0.5 < rms[2] / np.sqrt(found.variances[1]) < 2.0


def test_the_prior_holds_the_pose_where_nothing_is_seen_that_is_known():
    empty = Prediction(np.zeros((0, 3)), np.zeros((0, 3, 3)))
    nothing = np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros(0, dtype=np.int64)
    found = align_scan(*nothing, empty, np.ones((0, 1)), CONFIG, origin=ORIGIN, sigmas=np.array([0.5, 0.1]))
    np.testing.assert_allclose(found.T_correction, np.eye(4), atol=1e-12)
    np.testing.assert_allclose(found.variances, [0.25, 0.01])
    assert found.log_likelihood_ratio == pytest.approx(0.0)


def test_freedom_to_move_the_pose_is_paid_for():
    seen, covariances, predicted, beliefs = scene(np.eye(4), 0)
    labels = np.zeros(OBJECTS, dtype=np.int64)
    held = scan_log_likelihood_ratio(seen, covariances, labels, predicted, beliefs, CONFIG)
    narrow, wide = align(np.eye(4), 0, (0.1, 0.01)), align(np.eye(4), 0, (1.0, 0.1))
    assert wide.log_likelihood_ratio < narrow.log_likelihood_ratio < held + 3.0
    assert wide.log_likelihood_ratio < held


def test_a_prior_as_certain_as_the_scan_is_met_half_way():
    sigma_m = NOISE_M * float(np.sqrt(2.0 / OBJECTS))
    off = turned((0.06, 0.0), 0.0)
    alone, held = align(off, 1, (1.0, 1e-6)), align(off, 1, (sigma_m, 1e-6))
    assert held.T_correction[0, 3] == pytest.approx(0.5 * alone.T_correction[0, 3], rel=0.01)
