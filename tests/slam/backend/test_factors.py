"""Noise and kernels of factors, and what no factor is made of."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import L, X
from scipy.spatial.transform import Rotation

from slam.backend.factors import OBSERVATION_KERNEL_WIDTH, Edge, Observation, between_factor, observation_factors
from slam.common.arrays import FloatArray
from slam.common.errors import FactorGraphError
from slam.common.geometry import make_transform
from tests.helpers.poses import pose_at

FAR = np.array([6.0, 8.0, 0.0])
SIGMA_M = 0.2


def values(pose: FloatArray, point: FloatArray = FAR) -> gtsam.Values:
    found = gtsam.Values()
    found.insert(X(0), gtsam.Pose3())
    found.insert(X(1), gtsam.Pose3(pose))
    found.insert(L(0), point)
    return found


def edge(kind: str, *, is_gaussian: bool = False, **changed: FloatArray) -> Edge:
    parts = {"T_from_to": np.eye(4), "covariance": SIGMA_M**2 * np.eye(6)} | changed
    return Edge(0, 1, parts["T_from_to"], parts["covariance"], kind, is_gaussian)


def observed(position: FloatArray = FAR, inflation: float = 1.0) -> Observation:
    return Observation(0, 0, position, SIGMA_M**2 * np.eye(3), inflation)


def error(kind: str, off_m: float) -> float:
    return float(between_factor(edge(kind)).error(values(pose_at(off_m))))


def test_a_step_of_the_odometry_has_the_tails_of_students_t_distribution():
    squares, degrees = 100.0, 10.0
    # By the density of t of 6 coordinates whose information at zero is that of the Gaussian.
    assert error("odometry", 2.0) == pytest.approx(0.5 * (degrees + 6.0) * np.log1p(squares / (degrees + 6.0)))


@pytest.mark.parametrize("one", [edge("odometry", is_gaussian=True), edge("discontinuity"), edge("condensed")])
def test_a_gaussian_edge_counts_in_full(one):
    assert between_factor(one).error(values(pose_at(2.0))) == pytest.approx(0.5 * 100.0)


def test_a_closure_that_is_far_off_counts_less_and_less():
    assert error("closure", 2.0) == pytest.approx(0.5 * np.log1p(100.0))
    assert error("closure", 20.0) < 2.0 * error("closure", 2.0)


def ranged(off_m: float, width: float, inflation: float = 1.0) -> float:
    (factor,) = observation_factors([observed(inflation=inflation)], width, sensor_range_m=30.0)
    return float(factor.error(values(np.eye(4), FAR * (1.0 + off_m / 10.0))))


@pytest.mark.parametrize("width", [0.5, 1.5, 1e6])
def test_observations_have_a_cauchy_kernel_of_the_configured_width(width):
    off_m, sigmas = 3.0, 15.0
    assert ranged(off_m, width) == pytest.approx(0.5 * width**2 * np.log1p((sigmas / width) ** 2))


def test_errors_that_observations_share_make_each_count_less_and_leave_its_kernel_alone():
    assert ranged(3.0, 1e6, inflation=4.0) == pytest.approx(ranged(3.0, 1e6) / 4.0)
    width = 1.5
    expected = 0.5 * (width / 2.0) ** 2 * np.log1p((15.0 / width) ** 2)
    assert ranged(3.0, width, inflation=4.0) == pytest.approx(expected)


@pytest.mark.parametrize("sensor_range_m", [1.5, 30.0, 600.0])
@pytest.mark.parametrize("seed", range(5))
def test_the_error_of_an_observation_is_that_of_the_position_in_the_body(seed, sensor_range_m):
    """The linear system is that of the residual R^T (m - t) - p, weighed by the covariance."""
    rng = np.random.default_rng(seed)
    position, off = rng.uniform(-sensor_range_m, sensor_range_m, 3), rng.normal(size=3)
    A = rng.normal(size=(3, 3))
    observation = replace(observed(position), covariance=1e-4 * np.eye(3) + 0.01 * A @ A.T)
    plain = 1e6
    _, factor = observation_factors([observed(inflation=4.0), observation], plain, sensor_range_m=sensor_range_m)
    T_map_body = make_transform(Rotation.random(random_state=rng).as_matrix(), 100.0 * rng.normal(size=3))
    R, seen = T_map_body[:3, :3], position + off
    point = R @ seen + T_map_body[:3, 3]
    information = np.linalg.inv(observation.covariance)
    at = values(np.eye(4), point)
    at.update(X(0), gtsam.Pose3(T_map_body))
    np.testing.assert_allclose(2.0 * factor.error(at), off @ information @ off, rtol=1e-4)
    x, y, z = seen
    by_rotation = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    jacobian = np.hstack([R.T, by_rotation, -np.eye(3)])  # landmark; rotation and translation of the body
    graph = gtsam.NonlinearFactorGraph()
    graph.add(factor)
    expected = jacobian.T @ information @ jacobian
    hessian = graph.linearize(at).hessian()[0]
    np.testing.assert_allclose(hessian, expected, atol=1e-4 * np.abs(expected).max())


@pytest.mark.parametrize("T", [np.diag([1.0, 1.0, -1.0, 1.0]), 2.0 * np.eye(4), np.full((4, 4), np.nan)])
def test_what_is_no_rigid_transform_becomes_no_factor(T):
    with pytest.raises(FactorGraphError, match="edge 0 -> 1: not a rigid transform"):
        between_factor(edge("odometry", T_from_to=T))


@pytest.mark.parametrize("variance", [0.0, -1.0, -1e-3, np.nan, np.inf])
def test_what_is_no_covariance_becomes_no_factor(variance):
    with pytest.raises(FactorGraphError, match="edge 0 -> 1: the covariance"):
        between_factor(edge("odometry", covariance=np.diag([1.0] * 5 + [variance])))
    observation = replace(observed(), covariance=np.diag([1.0, variance, 1.0]))
    with pytest.raises(FactorGraphError, match="landmark 0 from keyframe 0"):
        observation_factors([observation], OBSERVATION_KERNEL_WIDTH, sensor_range_m=30.0)
