"""The scale of the odometry's noise, by the corrections of a Kalman filter that uses it."""

from __future__ import annotations

import numpy as np
import pytest

from slam.common.arrays import FloatArray
from slam.odometry.noise_scale import NoiseScale

TRANSLATION, TILT, HEADING = range(3)
FACTOR_OF_AXIS = np.array([TILT, TILT, HEADING, TRANSLATION, TRANSLATION, TRANSLATION])
Q = np.repeat([1e-4, 1e-2], 3)
"""Variances of a step by the model of the odometry, rotation first."""


class Filter:
    """A pose whose six coordinates are each measured after each step, with the noise ``R_ratio`` of a step."""

    def __init__(self, scale: NoiseScale, seed: int, R_ratio: float = 1.0) -> None:
        self.scale, self.rng, self.R = scale, np.random.default_rng(seed), R_ratio * Q
        self.error, self.P = np.zeros(6), np.zeros(6)

    def run(self, steps: int, sigmas: FloatArray) -> None:
        """Steps whose noise has ``sigmas`` (3,) times the model's, by translation, tilt and heading."""
        for _ in range(steps):
            self.error += sigmas[FACTOR_OF_AXIS] * np.sqrt(Q) * self.rng.normal(size=6)
            self.P += self.scale.factors[FACTOR_OF_AXIS] * Q
            gain = self.P / (self.P + self.R)
            correction = gain * (np.sqrt(self.R) * self.rng.normal(size=6) - self.error)
            self.scale.add(correction, np.diag(gain * self.P))
            self.error += correction
            self.P *= 1.0 - gain


@pytest.mark.parametrize("R_ratio", [0.1, 1.0, 10.0])
@pytest.mark.parametrize("sigmas", [(10.0, 1.0, 1.0), (1.0, 1.0, 5.0), (30.0, 1.0, 3.0)])
def test_factors_grow_to_the_ratio_of_the_variances(sigmas: tuple[float, ...], R_ratio: float) -> None:
    found = []
    for seed in range(5):
        scale = NoiseScale(1.0)
        Filter(scale, seed, R_ratio).run(400, np.array(sigmas))
        found.append(scale.factors)
    ratios = np.median(found, axis=0) / np.square(sigmas)
    assert (np.abs(np.log2(ratios)) < 1.0).all()


@pytest.mark.parametrize("least", [1.0, 9.0])
def test_factors_are_the_least_where_the_model_is_right(least: float) -> None:
    scale = NoiseScale(least)
    Filter(scale, 0).run(600, np.ones(3))
    assert scale.factors.min() >= least
    assert scale.factors.max() < 1.5 * least


def test_factors_fall_back_once_the_odometry_is_as_good_as_its_model() -> None:
    scale = NoiseScale(1.0)
    simulated = Filter(scale, 0)
    simulated.run(200, np.array([10.0, 1.0, 10.0]))
    assert scale.factors[[TRANSLATION, HEADING]].min() > 30.0
    simulated.run(600, np.ones(3))
    assert scale.factors.max() < 3.0


def test_single_outliers_among_corrections_do_not_change_the_scale() -> None:
    scale = NoiseScale(1.0)
    for count in range(200):
        error_m = 5.0 if count % 7 == 0 else 0.0
        scale.add(np.array([0.0, 0.0, 0.0, error_m, 0.0, 0.0]), np.diag(Q))
    np.testing.assert_array_equal(scale.factors, 1.0)


def test_corrections_that_tell_nothing_change_nothing() -> None:
    scale = NoiseScale(4.0)
    for _ in range(10):
        scale.add(np.zeros(6), np.zeros((6, 6)))
    np.testing.assert_array_equal(scale.factors, 4.0)


def test_tilt_keeps_the_least_factor_however_large_its_corrections_are() -> None:
    scale = NoiseScale(1.0)
    Filter(scale, 0).run(200, np.array([1.0, 30.0, 1.0]))
    assert scale.factors[TILT] == 1.0
