"""The factor graph: the truth recovered from wrong initial values.

Each test of the estimate has a twin with one factor corrupted, in which the same check must fail.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam.backend.factors import OBSERVATION_KERNEL_WIDTH
from slam.common.geometry import invert
from tests.helpers.graphs import odometry_edges
from tests.slam.backend.graphs import (
    EDGE_COVARIANCE,
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
    assert worst_pose_error_m(build(noisy_edges(), [], width)) > 1.0
    graph = build(noisy_edges(), sightings(), width)
    assert graph.optimize().converged
    assert_is_true(graph)


def test_a_rough_solution_takes_fewer_steps_and_leads_to_the_same_one():
    graph, rough = (build(noisy_edges(), sightings(), OBSERVATION_KERNEL_WIDTH) for _ in range(2))
    steps = graph.optimize().iterations
    assert rough.optimize(roughly=True).iterations < steps
    rough.optimize()
    assert_same_estimate(rough, graph, atol=0.01)


def test_a_robust_kernel_holds_against_one_mirrored_observation():
    observations = sightings()
    observations[20] = replace(observations[20], position=observations[20].position * [1, -1, 1])
    graph = build(odometry_edges(true_poses(), EDGE_COVARIANCE), observations, OBSERVATION_KERNEL_WIDTH)
    graph.optimize()
    assert_is_true(graph)


def test_the_incremental_and_the_batch_estimate_agree():
    graph = build(noisy_edges(), sightings())
    before = graph.poses()
    rows = graph.landmarks
    landmarks_before = graph.landmark_positions(rows)
    graph.optimize()
    np.testing.assert_allclose(before, graph.poses(), atol=0.02)
    np.testing.assert_allclose(landmarks_before, graph.landmark_positions(rows), atol=0.02)


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
