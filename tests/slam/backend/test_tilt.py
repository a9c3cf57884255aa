"""The tilt of the odometry is held where the whole graph does not contradict it."""

import gtsam
import numpy as np
import pytest

from slam.backend.factor_graph import FactorGraph
from slam.backend.factors import Edge, EdgeKind, Observation
from slam.backend.tilt import hold_tilt
from slam.common.arrays import FloatArray
from slam.common.geometry import relative, transform_from_xyz_yaw
from tests.helpers.graphs import chained, observed_from
from tests.helpers.poses import motion_by

KEYFRAMES, STEP_M = 120, 1.0
SIGMA_M = 0.1
"""Of each coordinate of a sighting."""
TILT_RAD = 0.01
"""Of a step, by its covariance."""


def true_poses() -> FloatArray:
    """A straight drive of a body that is turned upside down on the way."""
    poses = transform_from_xyz_yaw(np.stack([STEP_M * np.arange(KEYFRAMES), *np.zeros((2, KEYFRAMES))], axis=1), 0.0)
    return poses @ motion_by(np.linspace(np.zeros(3), [np.pi, 0.0, 0.0], KEYFRAMES))


def drive(drift_rad: float, seed: int) -> FactorGraph:
    """The graph of a drive whose odometry drifts in roll and pitch by so much a step."""
    rng, T = np.random.default_rng(seed), true_poses()
    R = T[:, :3, :3]
    landmarks = rng.uniform([-5.0, -8.0, -3.0], [KEYFRAMES * STEP_M + 5.0, 8.0, 3.0], (200, 3))
    upright = np.diag([TILT_RAD**2, TILT_RAD**2, 1e-6])
    edges, observations = list[Edge](), list[Observation]()
    for k in range(KEYFRAMES):
        if k:
            error = motion_by(R[k].T @ np.append(rng.normal(scale=drift_rad, size=2), 0.0))
            covariance = 1e-4 * np.eye(6)
            covariance[:3, :3] = R[k].T @ upright @ R[k]
            step = relative(T[k - 1], T[k]) @ error
            edges.append(Edge(k - 1, k, step, covariance, EdgeKind.ODOMETRY))
        near = np.flatnonzero(np.linalg.norm(landmarks - T[k][:3, 3], axis=1) < 6.0)
        errors = rng.normal(scale=SIGMA_M, size=(len(near), 3))
        observations += observed_from(k, T[k], landmarks, near, SIGMA_M**2 * np.eye(3), errors)
    return chained(T[0], edges, observations)


@pytest.fixture(params=range(3))
def seed(request: pytest.FixtureRequest) -> int:
    return int(request.param)


def poses_free_and_held(drift_rad: float, seed: int) -> tuple[FloatArray, FloatArray]:
    """Of such a drive, without and with its tilt being held, (K, 4, 4) each."""
    graph = drive(drift_rad, seed)
    graph.assume_gaussian_odometry()
    graph.optimize()
    free = graph.poses()
    hold_tilt(graph)
    return free, graph.poses()


def tilt_errors_rad(poses: FloatArray) -> FloatArray:
    """Angles (K,) by which the vertical of each keyframe is wrong."""
    up = np.einsum("kij,kj->ki", true_poses()[:, :3, :3], poses[:, 2, :3])
    return np.arccos(np.clip(up[:, 2], -1.0, 1.0))


def test_exact_tilt_is_held(seed):
    free, held = map(tilt_errors_rad, poses_free_and_held(0.0, seed))
    assert held.max() < 0.2 * free.max()


def test_tilt_that_drifts_less_than_configured_is_held_less_firmly(seed):
    free, held = map(tilt_errors_rad, poses_free_and_held(0.5 * TILT_RAD, seed))
    assert np.linalg.norm(held) < 0.97 * np.linalg.norm(free)


def test_drifting_tilt_is_estimated(seed):
    free, held = poses_free_and_held(TILT_RAD, seed)
    np.testing.assert_allclose(held, free, atol=1e-3)


def test_drive_whose_tilt_is_not_held_stays_where_it_was_before(monkeypatch):
    graph, before = drive(TILT_RAD, seed=0), list[FloatArray]()
    estimate = graph.estimate

    def recorded() -> gtsam.Values:
        before.append(graph.poses())
        return estimate()

    monkeypatch.setattr(graph, "estimate", recorded)
    hold_tilt(graph)
    np.testing.assert_array_equal(graph.poses(), before[0])


def test_graph_without_odometry_is_optimised():
    graph = chained(np.eye(4), [])
    hold_tilt(graph)
    assert graph.match_noise().converged
