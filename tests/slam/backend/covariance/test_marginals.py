"""Covariances of keyframes and landmarks, against the noise of their measurements and against draws."""

from dataclasses import replace
from itertools import pairwise

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import L, X

from slam.backend.covariance.marginals import compute_marginals, offset_covariances
from slam.backend.factor_graph import FactorGraph
from slam.backend.factors import (
    OBSERVATION_KERNEL_WIDTH,
    Edge,
    Observation,
    between_factor,
    observation_factors,
    prior_factor,
)
from slam.backend.solver import graph_of
from slam.common.arrays import FloatArray
from slam.common.geometry import invert
from tests.helpers.graphs import PLAIN, chained, odometry_edges
from tests.helpers.poses import motion_by, pose_at
from tests.slam.backend.graphs import edge, noisy_edges, sightings, true_landmarks, true_poses

EDGE_COVARIANCE = np.diag([0.01, 0.02, 0.03, 0.2, 0.1, 0.05]) ** 2
SEEN_COVARIANCE = 0.01 * np.eye(3)


def drive() -> tuple[FloatArray, list[Edge]]:
    """True poses (10, 4, 4) of a body that turns and leans more and more, and the odometry between them."""
    tilt = motion_by([0.0, 0.1, 0.0])
    T = [np.eye(4)]
    for _ in range(9):
        T.append(T[-1] @ pose_at(2.0, yaw=0.4) @ tilt)
    return np.array(T), odometry_edges(np.array(T), EDGE_COVARIANCE)


def optimized(
    edges: list[Edge], observations: list[Observation] | None = None, kernel_width: float = PLAIN
) -> FactorGraph:
    graph = chained(np.eye(4), edges, observations or [], kernel_width)
    graph.optimize()
    return graph


def test_a_keyframe_and_a_landmark_are_as_sure_as_the_one_measurement_of_each() -> None:
    graph = optimized(drive()[1][:1], [Observation(0, 7, np.array([3.0, 1.0, 0.5]), SEEN_COVARIANCE)])
    np.testing.assert_allclose(graph.covariances()[0][1], EDGE_COVARIANCE, rtol=1e-3, atol=1e-6)
    np.testing.assert_allclose(graph.covariances()[1][0], SEEN_COVARIANCE, rtol=1e-3, atol=1e-6)


def test_covariances_are_the_blocks_of_the_inverse() -> None:
    closure = edge(11, 0, invert(true_poses()[11]) @ true_poses()[0])
    factors = [
        *(between_factor(replace(each, is_gaussian=True)) for each in [*noisy_edges(), closure]),
        *observation_factors(sightings(), PLAIN, sensor_range_m=30.0),
    ]
    factors += [
        prior_factor(keyframe, gtsam.Pose3(), np.full(6, 0.1)) for keyframe in (0, 99)
    ]  # nothing couples the last
    values = gtsam.Values()
    for keyframe, T in enumerate(true_poses()):
        values.insert(X(keyframe), gtsam.Pose3(T))
    values.insert(X(99), gtsam.Pose3())
    for row in {each.landmark for each in sightings()}:
        values.insert(L(row), true_landmarks()[row])
    found, known = compute_marginals(factors, values), gtsam.Marginals(graph_of(factors), values)
    assert sorted(found) == sorted(values.keys())
    for key, covariance in found.items():
        np.testing.assert_allclose(covariance, known.marginalCovariance(key), rtol=1e-6, atol=1e-12)
    points = [key for key in values.keys() if gtsam.symbolChr(key) == ord("l")]  # noqa: SIM118
    pairs = [*pairwise(points)] * 60  # more than are solved for at once
    for pair, found_offset in zip(pairs, offset_covariances(factors, values, np.array(pairs)), strict=True):
        joint = known.jointMarginalCovariance(pair).fullMatrix().reshape(2, 3, 2, 3)
        offset = joint[0, :, 0] + joint[1, :, 1] - joint[0, :, 1] - joint[1, :, 0]
        np.testing.assert_allclose(found_offset, offset, rtol=1e-6, atol=1e-12)


def test_a_variable_that_nothing_determines_is_refused() -> None:
    values = gtsam.Values()
    for keyframe in (0, 1):
        values.insert(X(keyframe), gtsam.Pose3())
    factors = [between_factor(edge(0, 1, np.eye(4)))]
    with pytest.raises(RuntimeError):
        compute_marginals(factors, values)
    values.insert(L(0), np.zeros(3))
    values.insert(L(1), np.ones(3))
    with pytest.raises(RuntimeError):
        offset_covariances(factors, values, np.array([[L(0), L(1)]]))


def test_the_record_holds_them_and_they_follow_the_graph() -> None:
    T, edges = drive()
    graph = optimized(edges)
    before, _ = graph.covariances()
    np.testing.assert_array_equal(graph.to_record(0, np.arange(len(T)), before).pose_covariances, before)
    graph.add_edge(Edge(0, 9, T[9], 1e-4 * EDGE_COVARIANCE, "odometry"))
    after, _ = graph.covariances()
    assert np.all(np.diagonal(after[9]) < 0.1 * np.diagonal(before[9]))


@pytest.mark.parametrize("width", [1.5, 1e6])
@pytest.mark.parametrize("covariance_inflation", [1.0, 50.0])
def test_a_landmark_seen_often_has_the_covariance_that_it_is_told_to_have(
    width: float, covariance_inflation: float
) -> None:
    """By the kernels' own weights it would be told twice too large."""
    rng = np.random.default_rng(5)
    place, squares = np.array([8.0, 3.0, 1.0]), list[float]()
    for _ in range(80):
        seen = place + rng.normal(scale=0.1, size=(30, 3))
        observations = [Observation(0, 0, each, SEEN_COVARIANCE, covariance_inflation) for each in seen]
        graph = optimized([], observations, width)
        row = np.array([0])
        error, covariance = graph.landmark_positions(row)[0] - place, graph.covariances()[1][0]
        squares.append(float(error @ np.linalg.solve(covariance, error)) * covariance_inflation / 3.0)
    assert np.mean(squares) == pytest.approx(1.0, abs=0.3)


def test_outliers_say_next_to_nothing() -> None:
    rng = np.random.default_rng(6)
    place = np.array([8.0, 3.0, 1.0])
    good = [Observation(0, 0, place + rng.normal(scale=0.1, size=3), SEEN_COVARIANCE) for _ in range(30)]
    bad = [Observation(0, 0, place + rng.normal(scale=2.0, size=3), SEEN_COVARIANCE) for _ in range(10)]
    one, other = (optimized([], seen, OBSERVATION_KERNEL_WIDTH) for seen in (good, good + bad))
    ratio = np.trace(other.covariances()[1][0]) / np.trace(one.covariances()[1][0])
    assert 0.9 < ratio < 1.1


def test_noise_of_odometry_is_matched_to_residuals_axis_by_axis() -> None:
    rng, count = np.random.default_rng(1), 600
    true_sigmas = np.sqrt(np.diagonal(EDGE_COVARIANCE)) * [1.0, 1.0, 5.0, 1.0, 1.0, 1.0]
    step = pose_at(2.0, yaw=0.02)
    T, edges = [np.eye(4)], []
    for _ in range(count - 1):
        T.append(T[-1] @ step)
    for k in range(count - 1):
        error = rng.normal(scale=true_sigmas)
        measured = step @ motion_by(error[:3], error[3:])
        edges.append(Edge(k, k + 1, measured, EDGE_COVARIANCE, "odometry"))
    graph = optimized(edges)
    for k in range(4, count, 4):
        graph.add_edge(Edge(0, k, T[k], np.diag(np.repeat([1e-3, 1e-2], 3)) ** 2, "closure"))
    graph.optimize()
    before = pose_error_m(graph, np.array(T))
    graph.match_noise()
    assert pose_error_m(graph, np.array(T)) < 0.95 * before
    first = next(each for each in graph.factors.values() if isinstance(each, Edge) and each.kind == "odometry")
    np.testing.assert_allclose(np.sqrt(np.diagonal(first.covariance)), true_sigmas, rtol=0.3)


def pose_error_m(graph: FactorGraph, T: FloatArray) -> float:
    return float(np.sqrt(np.mean((graph.poses()[:, :3, 3] - T[:, :3, 3]) ** 2)))
