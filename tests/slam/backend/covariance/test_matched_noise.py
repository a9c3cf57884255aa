"""The noise that a drive shows, against draws of a noise that the factors do not tell."""

import numpy as np
import pytest
from scipy import sparse

from slam.backend.covariance.matched_noise import FEW, variance_factors
from slam.common.arrays import FloatArray

AXES = 6
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

    def factors(self, noise: FloatArray) -> FloatArray:
        return variance_factors(self.jacobian, self.residuals(noise), self.steps)

    def draw(self, rng: np.random.Generator, of_steps: FloatArray) -> FloatArray:
        """Noise (N,) with variances (6,) on the rows of the odometry, and 1 on the others."""
        noise = rng.normal(size=self.jacobian.shape[0])
        noise[self.steps] *= np.sqrt(of_steps)
        return noise


def test_the_noise_of_a_drive_is_found_axis_by_axis() -> None:
    rng = np.random.default_rng(1)
    chain, variances = Chain(1001), np.array([9.0, 0.05, 1.0, 4.0, 0.05, 1.0])
    median = np.median([chain.factors(chain.draw(rng, variances)) for _ in range(12)], axis=0)
    np.testing.assert_allclose(median, variances, rtol=0.5)
    np.testing.assert_array_equal(median[[2, 5]], 1.0)  # what is as it was said to be is left alone


@pytest.mark.parametrize(("steps", "alike"), [(1000, 10), (200, 5), (200, 20)])
def test_errors_that_go_on_are_found_though_each_is_small(steps: int, alike: int) -> None:
    rng = np.random.default_rng(2)
    chain, found = Chain(steps + 1), list[FloatArray]()
    for _ in range(10):
        noise = chain.draw(rng, np.ones(AXES))
        noise[chain.steps] = 0.9 * np.repeat(rng.normal(size=(steps // alike, AXES)), alike, axis=0)
        found.append(chain.factors(noise))
    assert np.all(np.median(found, axis=0) > 3.0)


def test_the_noise_of_a_short_drive_is_found() -> None:
    chain = Chain(41)
    noise = chain.draw(np.random.default_rng(4), np.full(AXES, 100.0))
    assert np.all(chain.factors(noise) > 10.0)


@pytest.mark.parametrize("poses", [2, FEW])
def test_a_short_drive_keeps_the_noise_that_it_was_given(poses: int) -> None:
    chain = Chain(poses)
    noise = chain.draw(np.random.default_rng(4), np.full(AXES, 100.0))
    np.testing.assert_array_equal(chain.factors(noise), 1.0)


def test_a_drive_that_measures_nothing_keeps_the_noise_that_it_was_given() -> None:
    chain = Chain(501)
    jacobian = chain.jacobian[: chain.steps.size + AXES]
    np.testing.assert_array_equal(variance_factors(jacobian, np.zeros(jacobian.shape[0]), chain.steps), 1.0)


def test_what_is_not_determined_is_refused() -> None:
    chain = Chain(301)
    with pytest.raises(RuntimeError):
        variance_factors(0.0 * chain.jacobian, np.zeros(chain.jacobian.shape[0]), chain.steps)
