"""Noise and kernels of factors, and what no factor is made of."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import L, X

from slam.backend.factors import Edge, EdgeKind, Observation, bearing_range_factors, between_factor
from slam.common.arrays import FloatArray
from slam.common.config import FactorGraphConfig
from slam.common.errors import FactorGraphError
from slam.common.geometry import transform_from_xyz_yaw

FAR = np.array([6.0, 8.0, 0.0])
SIGMA_M = 0.2


def values(pose: FloatArray, point: FloatArray = FAR) -> gtsam.Values:
    found = gtsam.Values()
    found.insert(X(0), gtsam.Pose3())
    found.insert(X(1), gtsam.Pose3(pose))
    found.insert(L(0), point)
    return found


def edge(kind: str, **changed: FloatArray) -> Edge:
    parts = {"T_from_to": np.eye(4), "covariance": SIGMA_M**2 * np.eye(6)} | changed
    return Edge(0, 1, parts["T_from_to"], parts["covariance"], EdgeKind(kind))


def observed(position: FloatArray = FAR, inflation: float = 1.0, sigma_m: float = SIGMA_M) -> Observation:
    return Observation(0, 0, position, sigma_m**2 * np.eye(3), inflation)


def error(kind: str, off_m: float) -> float:
    off = transform_from_xyz_yaw(np.array([off_m, 0.0, 0.0]), 0.0)
    return float(between_factor(edge(kind)).error(values(off)))


@pytest.mark.parametrize("kind", ["odometry", "discontinuity"])
def test_an_edge_of_the_odometry_counts_in_full(kind):
    assert error(kind, 2.0) == pytest.approx(0.5 * 100.0)


def test_a_closure_that_is_far_off_counts_less_and_less():
    assert error("closure", 2.0) == pytest.approx(0.5 * np.log1p(100.0))
    assert error("closure", 20.0) < 2.0 * error("closure", 2.0)


def ranged(off_m: float, kernel: str, inflation: float = 1.0) -> float:
    (factor,) = bearing_range_factors([observed(inflation=inflation)], FactorGraphConfig(observation_kernel=kernel))
    return float(factor.error(values(np.eye(4), FAR * (1.0 + off_m / 10.0))))


def test_observations_have_the_kernel_that_is_configured():
    off_m, sigmas = 3.0, 15.0
    width = FactorGraphConfig().observation_kernel_width
    assert ranged(off_m, "none") == pytest.approx(0.5 * sigmas**2)
    assert ranged(off_m, "huber") == pytest.approx(width * (sigmas - 0.5 * width))
    assert ranged(off_m, "cauchy") == pytest.approx(0.5 * width**2 * np.log1p((sigmas / width) ** 2))


def test_errors_that_observations_share_make_each_count_less_and_leave_its_kernel_alone():
    assert ranged(3.0, "none", inflation=4.0) == pytest.approx(ranged(3.0, "none") / 4.0)
    width = FactorGraphConfig().observation_kernel_width
    expected = 0.5 * (width / 2.0) ** 2 * np.log1p((15.0 / width) ** 2)
    assert ranged(3.0, "cauchy", inflation=4.0) == pytest.approx(expected)


def test_a_bearing_is_the_more_exact_the_farther_the_object():
    for range_m in (5.0, 50.0):
        config = FactorGraphConfig(observation_kernel="none")
        (factor,) = bearing_range_factors([observed(np.array([range_m, 0.0, 0.0]))], config)
        point = range_m * np.array([np.cos(0.01), np.sin(0.01), 0.0])
        expected = 0.5 * (0.01 * range_m / SIGMA_M) ** 2
        assert factor.error(values(np.eye(4), point)) == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("T", [np.diag([1.0, 1.0, -1.0, 1.0]), 2.0 * np.eye(4), np.full((4, 4), np.nan)])
def test_what_is_no_rigid_transform_becomes_no_factor(T):
    with pytest.raises(FactorGraphError, match="edge 0 -> 1: not a rigid transform"):
        between_factor(edge("odometry", T_from_to=T))


@pytest.mark.parametrize("covariance", [np.zeros((6, 6)), -np.eye(6), np.diag([1.0] * 5 + [-1e-3])])
def test_what_is_no_covariance_becomes_no_factor(covariance):
    with pytest.raises(FactorGraphError, match="edge 0 -> 1: the covariance is not positive definite"):
        between_factor(edge("odometry", covariance=covariance))
