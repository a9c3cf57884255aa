"""How the odometry goes on at an unexpected step, by the landmarks that are seen."""

from __future__ import annotations

import numpy as np
import pytest

from slam.common.calibration import ObjectCalibration
from slam.common.geometry import apply, transform_from_xyz_yaw
from slam.frontend.active_landmarks import Prediction
from slam.frontend.continuity import decide, scan_log_likelihood_ratio
from slam.odometry.unexpected_step import Continuation, UnexpectedStep

CONFIG = ObjectCalibration()


def log_likelihood_ratio(
    shift_m: float, turn_rad: float, *, objects: int = 12, seed: int = 0, known: float = 1.0
) -> float:
    rng = np.random.default_rng(seed)
    landmarks = np.column_stack([rng.uniform(-25, 25, (objects, 2)), np.zeros(objects)])
    T = transform_from_xyz_yaw(np.array([shift_m, 0.0, 0.0]), turn_rad)
    seen = apply(T, landmarks) + rng.normal(0.0, 0.1, landmarks.shape)
    new = rng.uniform(size=objects) >= known
    seen[new, :2] = rng.uniform(-25, 25, (int(new.sum()), 2))
    covariances = np.tile(0.02 * np.eye(3), (objects, 1, 1))
    labels = np.zeros(objects, dtype=np.int64)
    predicted = Prediction(landmarks, covariances)
    return scan_log_likelihood_ratio(seen, covariances, labels, predicted, np.ones((objects, 1)), CONFIG)


@pytest.mark.parametrize("seed", range(5))
def test_the_right_pose_is_far_likelier_than_no_pose_and_a_wrong_one_less_likely(seed):
    assert log_likelihood_ratio(0.0, 0.0, seed=seed) > 20.0
    assert log_likelihood_ratio(0.0, 0.0, seed=seed, known=0.6) > 5.0
    assert log_likelihood_ratio(5.0, 0.0, seed=seed) < 0.0
    assert log_likelihood_ratio(0.0, 0.5, seed=seed) < 0.0


@pytest.mark.parametrize("objects", [50, 200])
def test_a_crowd_does_not_make_a_wrong_pose_likely(objects):
    assert log_likelihood_ratio(5.0, 0.4, objects=objects) < 0.0


def test_nothing_seen_or_nothing_known_says_nothing():
    assert log_likelihood_ratio(0.0, 0.0, objects=0) == 0.0


REPORTED, EXPECTED, BROKEN = Continuation.REPORTED, Continuation.EXPECTED, Continuation.BROKEN


@pytest.mark.parametrize(
    ("reported", "expected", "default", "way"),
    [
        (-10.0, 20.0, BROKEN, EXPECTED),
        (20.0, -10.0, BROKEN, REPORTED),
        (20.0, 21.0, BROKEN, REPORTED),
        (20.0, 30.0, REPORTED, EXPECTED),
        (-10.0, 2.0, BROKEN, BROKEN),
        (-10.0, 2.0, REPORTED, REPORTED),
        (-10.0, -20.0, BROKEN, BROKEN),
    ],
)
def test_a_way_on_is_taken_if_it_is_much_likelier_than_the_others(reported, expected, default, way):
    step = UnexpectedStep((), {}, default, False)
    assert decide(step, {REPORTED: reported, EXPECTED: expected}) is way


def test_the_last_velocity_may_not_be_known():
    assert decide(UnexpectedStep((), {}, BROKEN, False), {REPORTED: 20.0}) is REPORTED


@pytest.mark.parametrize(
    ("reported", "expected", "known", "way"),
    [
        (20.0, 20.0, True, EXPECTED),
        (30.0, 20.0, True, REPORTED),
        (-10.0, -20.0, True, BROKEN),
        (20.0, 22.0, False, None),
        (20.0, 18.0, False, None),
        (20.0, 30.0, False, EXPECTED),
        (30.0, 20.0, False, REPORTED),
    ],
)
def test_whether_an_odometry_that_repeats_a_pose_is_frozen_may_show_later(reported, expected, known, way):
    velocity = np.array([5.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    step = UnexpectedStep((), {}, BROKEN, False, frozen_velocity=velocity, goes_on_frozen=known)
    assert decide(step, {REPORTED: reported, EXPECTED: expected}) is way
