"""The scale of the odometry's noise, by the innovations of a Kalman filter that uses it."""

import numpy as np
import pytest
from scipy.stats import chi2

from slam.common.arrays import FloatArray
from slam.odometry.noise_scale import GATE, WINDOW, NoiseScale, _weighted_median

TRANSLATION, HEADING = range(2)
NO_LIMIT = np.full(2, np.inf)
FACTOR_OF_AXIS = np.array([HEADING, TRANSLATION, TRANSLATION])
Q = np.array([1e-4, 1e-2, 1e-2])
"""Variances of heading, x and y after a step by the model of the odometry."""


class Filter:
    """A pose whose three coordinates are each measured after each step, with the noise ``R_ratio`` of a step."""

    def __init__(self, scale: NoiseScale, seed: int, R_ratio: float = 1.0) -> None:
        self.scale, self.rng, self.R = scale, np.random.default_rng(seed), R_ratio * Q
        self.error, self.P = np.zeros(3), np.zeros(3)

    def run(self, steps: int, sigmas: FloatArray) -> None:
        """Steps whose noise has ``sigmas`` (2,) times the model's, by translation and heading."""
        for _ in range(steps):
            self.error += sigmas[FACTOR_OF_AXIS] * np.sqrt(Q) * self.rng.normal(size=3)
            self.P += self.scale.factors[FACTOR_OF_AXIS] * Q
            S = self.P + self.R
            innovation = np.sqrt(self.R) * self.rng.normal(size=3) - self.error
            self.scale.add(innovation / np.sqrt(S), np.diag(np.sqrt(self.scale.factors[FACTOR_OF_AXIS] * Q / S)))
            self.error += self.P / S * innovation
            self.P *= self.R / S


@pytest.mark.parametrize("R_ratio", [0.1, 1.0, 10.0])
@pytest.mark.parametrize("sigmas", [(10.0, 1.0), (1.0, 5.0), (30.0, 3.0)])
def test_factors_grow_to_the_ratio_of_the_variances(sigmas: tuple[float, ...], R_ratio: float) -> None:
    found = []
    for seed in range(5):
        scale = NoiseScale(NO_LIMIT)
        Filter(scale, seed, R_ratio).run(400, np.array(sigmas))
        found.append(scale.factors)
    ratios = np.median(found, axis=0) / np.square(sigmas)
    assert (np.abs(np.log2(ratios)) < 1.0).all()


def test_factors_are_the_roots_by_which_median_innovations_exceed_those_expected() -> None:
    """Of two coordinates and a heading."""
    scale, medians = NoiseScale(NO_LIMIT), chi2.median([2, 1])
    translation, heading = np.sqrt([4.0, 9.0] * medians)
    for _ in range(WINDOW):
        scale.add(np.array([heading, 0.6 * translation, -0.8 * translation]), 0.7 * np.eye(3))
    np.testing.assert_allclose(scale.factors, [2.0, 3.0])
    assert scale.innovation_ratio == pytest.approx(9.0 * medians[1] / GATE)


@pytest.mark.parametrize("count", [1, 2, 5, 20])
def test_weighted_median_has_half_of_the_weight_on_either_side(count: int) -> None:
    values, weights = np.random.default_rng(count).random((2, count))
    found = _weighted_median(values, weights)
    for side in (values <= found, values >= found):
        assert weights[side].sum() >= 0.5 * weights.sum()


def test_factors_fall_back_once_the_odometry_is_as_good_as_its_model() -> None:
    scale = NoiseScale(NO_LIMIT)
    simulated = Filter(scale, 0)
    simulated.run(200, np.array([10.0, 10.0]))
    assert scale.factors.min() > 30.0
    simulated.run(600, np.ones(2))
    assert scale.factors.max() < 3.0


def test_single_outliers_among_innovations_do_not_change_the_scale() -> None:
    scale = NoiseScale(NO_LIMIT)
    for count in range(200):
        scale.add(np.array([0.0, 50.0 if count % 7 == 0 else 0.0, 0.0]), 0.7 * np.eye(3))
    np.testing.assert_array_equal(scale.factors, 1.0)


def test_scans_that_tell_little_count_little() -> None:
    """Three of four scans follow steps so short that they say nothing of the odometry, and fit."""
    scale, rng = NoiseScale(NO_LIMIT), np.random.default_rng(0)
    for count in range(800):
        share = 0.9 if count % 4 == 0 else 1e-6
        S = share * scale.factors[TRANSLATION] + 1.0 - share
        y = rng.normal(scale=np.sqrt(100.0 * share + 1.0 - share), size=2) / np.sqrt(S)
        scale.add(y, np.eye(2, 3, 1) * np.sqrt(share * scale.factors[TRANSLATION] / S))
    assert 50.0 < scale.factors[TRANSLATION] < 200.0


def test_innovations_that_nothing_of_the_odometry_moves_change_nothing() -> None:
    scale = NoiseScale(NO_LIMIT)
    for _ in range(40):
        scale.add(np.full(3, 9.0), np.zeros((3, 3)))
    np.testing.assert_array_equal(scale.factors, 1.0)


def test_factors_do_not_grow_without_end() -> None:
    scale = NoiseScale(np.array([50.0, 0.1]))
    for _ in range(10 * WINDOW):
        scale.add(np.full(3, 1e6), np.eye(3))
    np.testing.assert_array_equal(scale.factors, [50.0, 1.0])


FORWARD = np.array([0.0, 1.0, 0.0])


def orthogonal(rows: int) -> FloatArray:
    """Effects (rows, 3), each of norm 0.9, of errors that a scan tells apart."""
    return 0.9 * np.asarray(np.linalg.qr(np.random.default_rng(0).normal(size=(rows, 3)))[0])


def test_slip_is_the_error_of_the_step_by_the_innovations() -> None:
    effects = orthogonal(12)
    _, _, others = np.linalg.svd(effects.T)
    scale = NoiseScale(NO_LIMIT)
    slip = scale.slip(effects @ (60.0 * FORWARD) + 2.4 * others[-1], effects)
    np.testing.assert_allclose(slip, 0.81 * 60.0 * FORWARD, atol=1e-12)


def test_slip_is_what_the_model_does_not_explain_though_its_factor_grew() -> None:
    scale, effects = NoiseScale(NO_LIMIT), orthogonal(12)
    assert not scale.slip(effects @ (6.0 * FORWARD), effects).any()
    assert not scale.slip(effects @ (15.0 * FORWARD), effects).any()  # in one of three coordinates
    turns = [scale.slip(effects @ [sigmas, 0.0, 0.0], effects).any() for sigmas in (12.0, -13.0)]
    assert turns == [False, True]
    scale.factors = np.array([100.0, 1.0])
    assert scale.slip(effects @ (6.0 * FORWARD), effects).any()
    assert not scale.slip(effects @ (0.6 * FORWARD), effects).any()


def test_slip_explains_the_innovations_of_several_landmarks() -> None:
    scale, effects = NoiseScale(NO_LIMIT), orthogonal(12)
    _, _, others = np.linalg.svd(effects.T)
    assert not scale.slip(effects @ (60.0 * FORWARD) + 5.0 * others[-1], effects).any()
    assert not scale.slip(orthogonal(6) @ (60.0 * FORWARD), orthogonal(6)).any()


def test_slip_is_no_larger_than_the_innovations_tell() -> None:
    effects = 20.0 * orthogonal(12)
    assert not NoiseScale(NO_LIMIT).slip(effects @ (0.3 * FORWARD), effects).any()
