"""Covariances with the noise that a drive shows: against draws of a noise that the factors do not tell."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import sparse

from slam.backend.covariance.covariance_estimation import (
    STRETCH_STEPS,
    LinearSystem,
    covariance_blocks,
    variance_factors,
)
from slam.common.arrays import FloatArray

AXES = 6
SEEN_EVERY, SEEN_SIGMA = 5, 3.0
"""Every fifth pose is measured, with three times the noise of a step."""


def chain(poses: int, closures: int = 0) -> LinearSystem:
    """Six independent random walks from 0, with unit steps as the factors have it; residuals are not there yet.

    Closures tie poses of the first half to those of the second, with unit noise as they have it.
    """
    ones, rows = np.ones(poses - 1), np.arange(poses - 1)
    steps = sparse.csr_array((np.r_[-ones, ones], (np.r_[rows, rows], np.r_[rows, rows + 1])), shape=(poses - 1, poses))
    first = sparse.csr_array(([1e3], ([0], [0])), shape=(1, poses))
    seen = np.arange(0, poses, SEEN_EVERY)
    sights = sparse.csr_array((np.full(len(seen), 1.0 / SEEN_SIGMA), (np.arange(len(seen)), seen)), (len(seen), poses))
    a = np.arange(closures)
    loops = sparse.csr_array(
        (np.r_[-np.ones(closures), np.ones(closures)], (np.r_[a, a], np.r_[3 * a, poses - 1 - 2 * a])),
        (closures, poses),
    )
    one_axis = sparse.vstack([steps, loops, first, sights])
    jacobian = sparse.csr_array(sparse.kron(one_axis, sparse.eye_array(AXES)))
    of_rows = np.arange(jacobian.shape[0]).reshape(-1, AXES)
    return LinearSystem(
        jacobian,
        np.zeros(len(jacobian.indptr) - 1),
        np.ones(jacobian.shape[0]),
        of_rows[: poses - 1],
        of_rows[poses - 1 : poses - 1 + closures],
        np.repeat(np.arange(poses), AXES),
    )


def solve(system: LinearSystem, noise: FloatArray) -> tuple[LinearSystem, FloatArray]:
    """The system at its optimum for measurements with that noise (N,), and the errors (n,) of the estimate."""
    weighted = system.jacobian.T @ sparse.diags_array(system.kernel_weight)
    errors = sparse.linalg.spsolve(sparse.csc_array(weighted @ system.jacobian), weighted @ noise)
    residuals = noise - system.jacobian @ errors
    return LinearSystem(
        system.jacobian, residuals, system.kernel_weight, system.odometry_rows, system.closure_rows, system.owners
    ), errors


def draw(system: LinearSystem, rng: np.random.Generator, of_steps: FloatArray, of_closures: FloatArray) -> FloatArray:
    """Noise (N,) with variances (6,) on the rows of the odometry and of the closures, and 1 on the others."""
    noise = rng.normal(size=len(system.residuals))
    noise[system.odometry_rows] *= np.sqrt(of_steps)
    noise[system.closure_rows] *= np.sqrt(of_closures)
    return noise


def nees_of_axes(blocks: FloatArray, errors: FloatArray) -> FloatArray:
    """Mean (6,) over the poses, which are independent axis by axis."""
    return np.asarray(np.mean(errors.reshape(-1, AXES) ** 2 / np.diagonal(blocks, axis1=1, axis2=2), axis=0))


def dense_sandwich(system: LinearSystem, factors: FloatArray) -> FloatArray:
    J = system.jacobian.toarray()
    inverse = np.linalg.inv(J.T @ (system.kernel_weight[:, None] * J))
    whole = inverse @ (J.T @ ((system.kernel_weight**2 * factors)[:, None] * J)) @ inverse
    return np.stack([whole[i : i + AXES, i : i + AXES] for i in range(0, len(whole), AXES)])


@pytest.mark.parametrize("is_trusted", [True, False])
def test_the_blocks_are_those_of_the_sandwich(is_trusted: bool) -> None:
    rng = np.random.default_rng(0)
    system = chain(40, closures=3)
    if not is_trusted:
        system.kernel_weight[:] = rng.uniform(0.2, 1.0, len(system.kernel_weight))
    factors = rng.uniform(0.1, 10.0, len(system.residuals))
    expected = dense_sandwich(system, factors)
    np.testing.assert_allclose(covariance_blocks(system, factors), expected, rtol=1e-9, atol=1e-12)


def test_the_noise_of_a_drive_is_found_axis_by_axis() -> None:
    rng = np.random.default_rng(1)
    system, found = chain(20 * STRETCH_STEPS + 1, closures=20), list[FloatArray]()
    for_steps, for_closures = np.array([9.0, 0.2, 1.0, 4.0, 0.05, 1.0]), np.array([1.0, 1.0, 25.0, 1.0, 1.0, 1.0])
    for _ in range(12):
        solved, _ = solve(system, draw(system, rng, for_steps, for_closures))
        factors = variance_factors(solved)
        found.append(np.concatenate([factors[system.odometry_rows[0]], factors[system.closure_rows[0]]]))
        others = np.delete(factors, np.concatenate([system.odometry_rows, system.closure_rows]).ravel())
        np.testing.assert_array_equal(others, 1.0)
    median = np.median(found, axis=0)
    np.testing.assert_allclose(median[:AXES], for_steps, rtol=0.5)
    # Where the odometry errs otherwise than it was said to, closures cannot be told from it.
    np.testing.assert_allclose(median[AXES + 2], for_closures[2], rtol=0.5)
    np.testing.assert_array_equal(median[[2, 5]], 1.0)  # what is as it was said to be is left alone


def test_errors_that_go_on_from_step_to_step_are_found_though_each_is_small() -> None:
    rng = np.random.default_rng(2)
    system = chain(20 * STRETCH_STEPS + 1)
    noise = draw(system, rng, np.ones(AXES), np.ones(AXES))
    shared = np.repeat(rng.normal(size=(100, AXES)), 10, axis=0)  # ten steps err alike, each by less than was said
    noise[system.odometry_rows] = 0.9 * shared
    solved, errors = solve(system, noise)
    factors = variance_factors(solved)
    assert np.all(factors[system.odometry_rows] > 3.0)
    before = nees_of_axes(covariance_blocks(solved, np.ones(len(noise))), errors).mean()
    after = nees_of_axes(covariance_blocks(solved, factors), errors).mean()
    assert before > 1.5
    assert 0.2 < after < 1.0  # it is too careful about the ends of short ways, as if the steps erred alone


@pytest.mark.parametrize("poses", [2, 4 * STRETCH_STEPS])
def test_a_short_drive_keeps_the_noise_that_it_was_given(poses: int) -> None:
    system = chain(poses)
    solved, _ = solve(system, draw(system, np.random.default_rng(4), np.full(AXES, 100.0), np.ones(AXES)))
    np.testing.assert_array_equal(variance_factors(solved), 1.0)


def test_a_drive_that_measures_nothing_keeps_the_noise_that_it_was_given() -> None:
    system = chain(10 * STRETCH_STEPS + 1)
    kept = np.concatenate([system.odometry_rows.ravel(), np.arange(AXES) + system.odometry_rows.size])
    rows = np.arange(len(system.odometry_rows) * AXES).reshape(-1, AXES)
    none = np.zeros((0, AXES), dtype=np.int64)
    alone = LinearSystem(system.jacobian[kept], np.zeros(len(kept)), np.ones(len(kept)), rows, none, system.owners)
    np.testing.assert_array_equal(variance_factors(alone), 1.0)


def test_what_is_not_determined_is_refused() -> None:
    system = chain(6 * STRETCH_STEPS)
    empty = LinearSystem(  # type: ignore[call-arg]
        0.0 * system.jacobian, system.residuals, system.kernel_weight, *[system.odometry_rows] * 2, system.owners
    )
    with pytest.raises(np.linalg.LinAlgError):
        variance_factors(empty)
    with pytest.raises(np.linalg.LinAlgError):
        covariance_blocks(empty, np.ones(len(empty.residuals)))
