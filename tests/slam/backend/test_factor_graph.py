"""The factor graph: the truth recovered from wrong initial values, and what it refuses.

Each test of the estimate has a twin with one factor corrupted, in which the same check must fail.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from slam.backend.factor_graph import FactorGraph
from slam.backend.factors import OBSERVATION_KERNEL_WIDTH, Observation
from slam.common.errors import FactorGraphError
from slam.common.geometry import invert
from tests.helpers.graphs import PLAIN, odometry_edges
from tests.slam.backend.graphs import (
    EDGE_COVARIANCE,
    KEYFRAMES,
    SEEN_COVARIANCE,
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
    assert worst_pose_error_m(build(noisy_edges(), [], width), true_poses()) > 1.0
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


def test_the_incremental_and_the_batch_estimate_agree(graph):
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


# What it refuses

NOWHERE = np.full((4, 4), np.nan)
HERE = np.eye(4)
AHEAD = np.array([5.0, 0.0, 0.0])
UNKNOWN_KEYFRAME, UNKNOWN_LANDMARK = KEYFRAMES + 28, 77
REFUSED: dict[str, tuple[Callable[[FactorGraph], object], str]] = {
    "no transform to the next keyframe": (lambda graph: graph.add_next_keyframe(edge(11, 12, NOWHERE)), "keyframe 12"),
    "no covariance of the next keyframe": (
        lambda graph: graph.add_next_keyframe(replace(edge(11, 12, HERE), covariance=-np.eye(6))),
        "11 -> 12",
    ),
    "no position": (
        lambda graph: graph.add_observations([Observation(2, UNKNOWN_LANDMARK, AHEAD * np.nan, SEEN_COVARIANCE)]),
        "landmark 77",
    ),
    "the pose of an unknown keyframe": (lambda graph: graph.pose(UNKNOWN_KEYFRAME), "keyframe 40"),
    "an observation from an unknown keyframe": (
        lambda graph: graph.add_observations([Observation(UNKNOWN_KEYFRAME, 4, AHEAD, SEEN_COVARIANCE)]),
        "keyframe 40",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_it_is_refused_by_name(graph, name):
    call, told = REFUSED[name]
    with pytest.raises(FactorGraphError, match=told):
        call(graph)


@pytest.mark.parametrize(
    ("add", "told"),
    [
        (lambda graph: graph.add_keyframe(17, NOWHERE), "keyframe 17"),
        (lambda graph: graph.add_next_keyframe(edge(0, 1, HERE)), "keyframe 0"),
    ],
)
def test_a_graph_begins_with_a_keyframe_that_is_held(add, told):
    with pytest.raises(FactorGraphError, match=told):
        add(FactorGraph(kernel_width=PLAIN))
