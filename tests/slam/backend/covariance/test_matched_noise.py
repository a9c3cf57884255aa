"""The noise that a drive shows, against draws of a noise that the factors do not tell."""

from functools import partial

import numpy as np
import pytest
from scipy import sparse

from slam.backend.covariance.marginals import factorize
from slam.backend.covariance.matched_noise import stretch_lengths, variance_factors
from slam.common.arrays import FloatArray

AXES = 6
STRETCH_STEPS = 50
SEEN_EVERY, SEEN_SIGMA = 5, 3.0
"""Every fifth pose is measured, with three times the noise of a step."""


class Chain:
    """Six independent random walks from 0, with unit steps as the factors have it."""

    def __init__(self, poses: int) -> None:
        ones, rows = np.ones(poses - 1), np.arange(poses - 1)
        steps = sparse.csr_array((np.r_[-ones, ones], (np.r_[rows, rows], np.r_[rows, rows + 1])), (poses - 1, poses))
        first = sparse.csr_array(([1e3], ([0], [0])), shape=(1, poses))
        seen = np.arange(0, poses, SEEN_EVERY)
        sights = sparse.csr_array(
            (np.full(len(seen), 1 / SEEN_SIGMA), (np.arange(len(seen)), seen)), (len(seen), poses)
        )
        one_axis = sparse.vstack([steps, first, sights])
        self.jacobian = sparse.csr_array(sparse.kron(one_axis, sparse.eye_array(AXES)))
        self.steps = np.arange((poses - 1) * AXES).reshape(-1, AXES)

    def residuals(self, noise: FloatArray) -> FloatArray:
        """At the optimum for measurements with that noise (N,)."""
        J = self.jacobian
        return np.asarray(noise - J @ sparse.linalg.spsolve(sparse.csc_array(J.T @ J), J.T @ noise))

    def factors(self, noise: FloatArray, length: int = STRETCH_STEPS) -> FloatArray:
        return self.factors_by(self.residuals(noise), length)

    def factors_by(self, residuals: FloatArray, length: int = STRETCH_STEPS) -> FloatArray:
        return variance_factors(self.jacobian, residuals, self.steps, length, partial(factorize, self.jacobian))

    def draw(self, rng: np.random.Generator, of_steps: FloatArray) -> FloatArray:
        """Noise (N,) with variances (6,) on the rows of the odometry, and 1 on the others."""
        noise = rng.normal(size=self.jacobian.shape[0])
        noise[self.steps] *= np.sqrt(of_steps)
        return noise


def test_the_noise_of_a_drive_is_found_axis_by_axis() -> None:
    rng = np.random.default_rng(1)
    chain, variances = Chain(20 * STRETCH_STEPS + 1), np.array([9.0, 0.2, 1.0, 4.0, 0.05, 1.0])
    median = np.median([chain.factors(chain.draw(rng, variances)) for _ in range(12)], axis=0)
    np.testing.assert_allclose(median, variances, rtol=0.5)
    np.testing.assert_array_equal(median[[2, 5]], 1.0)  # what is as it was said to be is left alone


def test_errors_that_go_on_from_step_to_step_are_found_though_each_is_small() -> None:
    rng = np.random.default_rng(2)
    chain = Chain(20 * STRETCH_STEPS + 1)
    noise = chain.draw(rng, np.ones(AXES))
    noise[chain.steps] = 0.9 * np.repeat(rng.normal(size=(100, AXES)), 10, axis=0)  # ten steps err alike
    assert np.all(chain.factors(noise) > 3.0)


@pytest.mark.parametrize(("steps", "lengths"), [(1, {1}), (103, {20, 5}), (2000, {400, 100})])
def test_stretches_are_shares_of_the_drive(steps: int, lengths: set[int]) -> None:
    assert stretch_lengths(steps) == lengths


@pytest.mark.parametrize("alike", [5, 20])
def test_errors_that_go_on_are_found_in_a_short_drive(alike: int) -> None:
    rng = np.random.default_rng(3)
    chain, found = Chain(201), list[FloatArray]()
    for _ in range(10):
        noise = chain.draw(rng, np.ones(AXES))
        noise[chain.steps] = 1.5 * np.repeat(rng.normal(size=(200 // alike, AXES)), alike, axis=0)
        found.append(np.max([chain.factors(noise, length=each) for each in stretch_lengths(200)], axis=0))
    assert np.all(np.median(found, axis=0) > 2.5)


@pytest.mark.parametrize("poses", [2, 4 * STRETCH_STEPS])
def test_a_short_drive_keeps_the_noise_that_it_was_given(poses: int) -> None:
    chain = Chain(poses)
    noise = chain.draw(np.random.default_rng(4), np.full(AXES, 100.0))
    np.testing.assert_array_equal(chain.factors(noise), 1.0)


def test_a_drive_that_measures_nothing_keeps_the_noise_that_it_was_given() -> None:
    chain = Chain(10 * STRETCH_STEPS + 1)
    chain.jacobian = chain.jacobian[: chain.steps.size + AXES]
    found = chain.factors_by(np.zeros(chain.jacobian.shape[0]))
    np.testing.assert_array_equal(found, 1.0)


def test_what_is_not_determined_is_refused() -> None:
    chain = Chain(6 * STRETCH_STEPS)
    chain.jacobian = 0.0 * chain.jacobian
    with pytest.raises(RuntimeError):
        chain.factors_by(np.zeros(chain.jacobian.shape[0]))
