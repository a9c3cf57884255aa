"""A small graph whose truth is known, with noisy edges and observations."""

import numpy as np

from slam.backend.factor_graph import FactorGraph
from slam.backend.factors import Edge, Observation
from slam.common.arrays import FloatArray
from slam.common.geometry import invert, transform_from_xyz_yaw
from tests.helpers.graphs import PLAIN, observed_from
from tests.helpers.poses import motion_by

EDGE_COVARIANCE = np.diag(np.repeat([0.05**2, 0.2**2], 3))
SEEN_COVARIANCE = 0.02**2 * np.eye(3)
KEYFRAMES, LANDMARKS = 12, 15
OFTEN_SEEN = 7


def true_poses() -> FloatArray:
    """A round of 12 keyframes on a circle of 8 m, with some tilt and height."""
    around = 2 * np.pi * np.arange(KEYFRAMES) / KEYFRAMES
    xyz = np.stack([8 * np.sin(around), 8 - 8 * np.cos(around), 0.5 * np.sin(2 * around)], axis=1)
    tilt = motion_by(np.outer(0.05 * np.sin(around), [0.0, 1.0, 0.0]))
    return transform_from_xyz_yaw(xyz, around) @ tilt


def true_landmarks() -> FloatArray:
    return np.random.default_rng(0).uniform([-14, -6, -1], [14, 22, 3], (LANDMARKS, 3))


def edge(a: int, b: int, T: FloatArray, kind: str = "odometry") -> Edge:
    return Edge(a, b, T, EDGE_COVARIANCE, kind)


def noisy_edges() -> list[Edge]:
    """Odometry that is wrong by 0.2 m and 3 deg a step, so that its chain, the initial values, is metres off."""
    rng = np.random.default_rng(1)
    T = true_poses()
    edges = []
    for i in range(KEYFRAMES - 1):
        error = motion_by(rng.normal(scale=0.05, size=3), rng.normal(scale=0.2, size=3))
        edges.append(edge(i, i + 1, invert(T[i]) @ T[i + 1] @ error))
    return edges


def sightings(seed: int = 2, sigma_m: float = 0.005, poses: FloatArray | None = None) -> list[Observation]:
    """Each keyframe sees the eight landmarks nearest to it."""
    rng = np.random.default_rng(seed)
    found = list[Observation]()
    for k, T in enumerate(true_poses() if poses is None else poses):
        nearest = np.argsort(np.linalg.norm(true_landmarks() - T[:3, 3], axis=1))[:8]
        errors = rng.normal(scale=sigma_m, size=(8, 3))
        found += observed_from(k, T, true_landmarks(), nearest, SEEN_COVARIANCE, errors)
    return found


def build(
    edges: list[Edge], observations: list[Observation], kernel_width: float = PLAIN, *, keyframes: int = KEYFRAMES
) -> FactorGraph:
    """The graph as a drive builds it: keyframe by keyframe, with an update after each."""
    graph = FactorGraph(kernel_width=kernel_width)
    graph.add_keyframe(0, true_poses()[0])
    for k in range(keyframes):
        if k > 0:
            graph.add_next_keyframe(edges[k - 1])
        graph.add_observations([o for o in observations if o.keyframe == k])
        graph.update()
    for extra in edges[keyframes - 1 :]:
        graph.add_edge(extra)
    graph.update()
    return graph


def worst_pose_error_m(graph: FactorGraph, T: FloatArray) -> float:
    return float(np.linalg.norm(graph.poses()[:, :3, 3] - T[:, :3, 3], axis=1).max())


def assert_is_true(graph: FactorGraph) -> None:
    T = graph.poses()
    np.testing.assert_allclose(T[:, :3, 3], true_poses()[:, :3, 3], atol=0.05)
    np.testing.assert_allclose(T[:, :3, :3], true_poses()[:, :3, :3], atol=0.01)
    rows = graph.landmarks
    np.testing.assert_allclose(graph.landmark_positions(rows), true_landmarks()[rows], atol=0.05)


def assert_same_estimate(a: FactorGraph, b: FactorGraph, atol: float = 1e-6) -> None:
    np.testing.assert_array_equal(a.keyframes, b.keyframes)
    np.testing.assert_array_equal(a.landmarks, b.landmarks)
    np.testing.assert_allclose(a.poses(), b.poses(), atol=atol)
    np.testing.assert_allclose(a.landmark_positions(a.landmarks), b.landmark_positions(b.landmarks), atol=atol)
    np.testing.assert_allclose(a.covariances()[1], b.covariances()[1], atol=atol, rtol=1e-3)
