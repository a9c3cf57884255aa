"""The factor graph: the truth recovered from wrong initial values, and the noise of observations.

Each test of the estimate has a twin with one factor corrupted, in which the same check must fail.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slam.backend.factor_graph import FactorGraph
from slam.backend.factors import Edge, Observation
from slam.backend.solver_options import FactorGraphConfig
from slam.common.arrays import FloatArray
from slam.common.geometry import apply, invert, make_transform
from tests.slam.backend.graphs import (
    KEYFRAMES,
    PLAIN,
    assert_is_true,
    assert_same_estimate,
    build,
    edge,
    noisy_edges,
    sightings,
    true_poses,
    worst_pose_error_m,
)


@pytest.mark.parametrize("width", [30.0, 1e6])
def test_the_truth_is_recovered_from_initial_values_that_are_metres_off(width):
    config = FactorGraphConfig(observation_kernel_width=width)
    assert worst_pose_error_m(build(noisy_edges(), [], config)) > 1.0
    graph = build(noisy_edges(), sightings(), config)
    optimization = graph.optimize()
    assert optimization.converged
    assert optimization.error_after <= optimization.error_before
    assert_is_true(graph)


def test_a_rough_solution_takes_fewer_steps_and_leads_to_the_same_one():
    config = FactorGraphConfig()
    graph, rough = (build(noisy_edges(), sightings(), config) for _ in range(2))
    steps = graph.optimize().iterations
    assert rough.optimize(roughly=True).iterations < steps
    rough.optimize()
    assert_same_estimate(rough, graph, atol=0.01)


def wrong_edge(edges: list[Edge]) -> list[Edge]:
    T = edges[5].T_from_to.copy()
    T[0, 3] += 7.0
    tight = replace(edges[5], T_from_to=T, covariance=1e-4 * np.eye(6))
    return [*edges[:5], tight, *edges[6:]]


def test_twin_an_edge_that_is_wrong_by_seven_metres_is_seen():
    graph = build(wrong_edge(noisy_edges()), sightings())
    graph.optimize()
    with pytest.raises(AssertionError):
        assert_is_true(graph)


def test_twin_a_mirrored_observation_is_seen():
    observations = sightings()
    observations[20] = replace(observations[20], position=observations[20].position * [1, -1, 1])
    graph = build(noisy_edges(), observations)
    graph.optimize()
    with pytest.raises(AssertionError):
        assert_is_true(graph)


def test_a_robust_kernel_holds_against_one_mirrored_observation():
    observations = sightings()
    observations[20] = replace(observations[20], position=observations[20].position * [1, -1, 1])
    exact = [edge(i, i + 1, invert(true_poses()[i]) @ true_poses()[i + 1]) for i in range(KEYFRAMES - 1)]
    graph = build(exact, observations, FactorGraphConfig())
    graph.optimize()
    assert_is_true(graph)


def test_the_incremental_and_the_batch_estimate_agree():
    graph = build(
        noisy_edges(),
        sightings(),
        FactorGraphConfig(observation_kernel_width=1e6, relinearize_skip=1),
    )
    before = graph.poses()
    rows = graph.landmarks
    landmarks_before = graph.landmark_positions(rows)
    graph.optimize()
    np.testing.assert_allclose(before, graph.poses(), atol=0.02)
    np.testing.assert_allclose(landmarks_before, graph.landmark_positions(rows), atol=0.02)


def test_a_closure_between_far_keyframes_bends_the_chain():
    T = true_poses()
    closure = replace(edge(0, 11, invert(T[0]) @ T[11], "closure"), covariance=1e-6 * np.eye(6))
    open_loop, closed = build(noisy_edges(), []), build([*noisy_edges(), closure], [])
    assert np.linalg.norm(open_loop.pose(11)[:3, 3] - T[11, :3, 3]) > 1.0
    closed.optimize()
    np.testing.assert_allclose(closed.pose(11), T[11], atol=0.02)
    assert worst_pose_error_m(closed) < worst_pose_error_m(open_loop)


def test_a_pose_that_was_asked_for_is_another_after_the_next_update():
    T = true_poses()
    graph = build(noisy_edges(), [])
    graph.update()
    before = graph.pose(11)
    graph.pose(11)[:] = np.nan  # what is handed out is the caller's
    assert np.array_equal(graph.pose(11), before)
    graph.add_edge(replace(edge(0, 11, invert(T[0]) @ T[11], "closure"), covariance=1e-6 * np.eye(6)))
    graph.update()
    assert np.linalg.norm((graph.pose(11) - before)[:3, 3]) > 0.5


def test_twin_a_closure_the_wrong_way_round_does_not_close():
    T = true_poses()
    backwards = replace(edge(11, 0, invert(T[0]) @ T[11], "closure"), covariance=1e-6 * np.eye(6))
    graph = build([*noisy_edges(), backwards], [])
    graph.optimize()
    assert np.linalg.norm(graph.pose(11)[:3, 3] - T[11, :3, 3]) > 0.5


def chi_squared_of(
    position: FloatArray, off: FloatArray, covariance: FloatArray, covariance_inflation: float = 1.0
) -> float:
    """What an observation costs whose landmark is fixed at ``position`` by another one, 2000 times tighter."""
    graph = FactorGraph(PLAIN)
    graph.add_first_keyframe(0, np.eye(4))
    graph.add_observations(
        [
            Observation(0, 1, position, 1e-12 * np.eye(3)),
            Observation(0, 1, position + off, covariance, covariance_inflation),
        ]
    )
    return 2.0 * graph.optimize().error_after


def sight_covariance(position: FloatArray, along_m: float, across_m: float) -> FloatArray:
    """Noise of one size along the line of sight and of another across it."""
    sight = np.outer(position, position) / (position @ position)
    return along_m**2 * sight + across_m**2 * (np.eye(3) - sight)


@pytest.mark.parametrize("seed", range(20))
def test_an_observation_costs_what_its_covariance_says(seed):
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=3)
    position = 25.0 * direction / np.linalg.norm(direction)
    covariance = sight_covariance(position, *rng.uniform(0.05, 0.3, size=2))
    off = rng.multivariate_normal(np.zeros(3), 0.01 * covariance)
    expected = off @ np.linalg.solve(covariance, off)
    np.testing.assert_allclose(chi_squared_of(position, off, covariance), expected, rtol=0.02)
    np.testing.assert_allclose(chi_squared_of(position, off, covariance, 4.0), 0.25 * expected, rtol=0.02)


POSITIONS = [(20.0, 0.01, 0.02), (20.0, 0.1, 0.05), (0.01, 15.0, 0.02), (0.02, -0.01, 10.0), (0.0, 0.0, 0.0)]


@pytest.mark.parametrize("position", POSITIONS)
def test_a_height_that_is_hardly_known_leaves_the_azimuth_its_weight(position):
    covariance = np.diag([0.1, 0.05, 5.0]) ** 2
    for off in 0.2 * np.array([[0.0, 0.1, 0.0], [0.1, -0.1, 0.0], [0.03, 0.1, -2.0]]):
        expected = off @ np.linalg.solve(covariance, off)
        np.testing.assert_allclose(chi_squared_of(np.array(position), off, covariance), expected, rtol=1e-3)


@pytest.mark.parametrize("covariance_inflation", [1.0, 9.0])
def test_the_covariance_of_a_landmark_seen_once_is_that_of_its_sighting_in_the_map(covariance_inflation):
    rng = np.random.default_rng(5)
    T = make_transform(Rotation.random(random_state=rng).as_matrix(), np.array([100.0, -40.0, 3.0]))
    position = np.array([12.0, 5.0, 2.0])
    covariance = sight_covariance(position, 0.1, 0.2)
    graph = FactorGraph(PLAIN)
    graph.add_first_keyframe(0, T)
    graph.add_observations([Observation(0, 3, position, covariance, covariance_inflation)])
    graph.update()
    R = T[:3, :3]
    np.testing.assert_allclose(
        graph.landmark_covariances(np.array([3]))[0], covariance_inflation * R @ covariance @ R.T, atol=1e-5
    )


def test_the_covariance_of_a_landmark_behind_an_edge_holds_the_edges_noise_too():
    """First-order propagation through T_0_1 @ p with numerical derivatives."""
    T_0_1 = make_transform(Rotation.from_rotvec([0.1, -0.2, 0.7]).as_matrix(), np.array([5.0, 1.0, 0.2]))
    position = np.array([8.0, -3.0, 1.0])
    covariance = sight_covariance(position, 0.1, 0.3)
    edge_covariance = np.diag([0.01, 0.02, 0.03, 0.1, 0.2, 0.05]) ** 2
    graph = FactorGraph(PLAIN)
    graph.add_first_keyframe(0, np.eye(4))
    graph.add_next_keyframe(Edge(0, 1, T_0_1, edge_covariance, "odometry"))
    graph.add_observations([Observation(1, 0, position, covariance)])
    graph.optimize()

    def landmark(step: FloatArray) -> FloatArray:
        error = make_transform(Rotation.from_rotvec(step[:3]).as_matrix(), step[3:])
        return apply(T_0_1 @ error, position[None])[0]

    J = np.stack([(landmark(1e-6 * e) - landmark(-1e-6 * e)) / 2e-6 for e in np.eye(6)], axis=1)
    R = T_0_1[:3, :3]
    np.testing.assert_allclose(
        graph.landmark_covariances(np.array([0]))[0], J @ edge_covariance @ J.T + R @ covariance @ R.T, atol=1e-5
    )
