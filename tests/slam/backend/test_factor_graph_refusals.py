"""The factor graph: what it refuses, and that nothing is left of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam.backend.factor_graph import FactorGraph
from slam.backend.factors import Edge, Observation
from slam.common.arrays import FloatArray
from slam.common.errors import FactorGraphError
from slam.common.geometry import invert
from tests.slam.backend.graphs import (
    KEYFRAMES,
    OFTEN_SEEN,
    PLAIN,
    SEEN_COVARIANCE,
    assert_is_true,
    assert_same_estimate,
    build,
    edge,
    noisy_edges,
    sightings,
    true_poses,
)


def skewed() -> FloatArray:
    T = np.eye(4)
    T[0, 1] = 0.01
    return T


def mirrored() -> FloatArray:
    return np.diag([1.0, -1.0, 1.0, 1.0])


def not_a_number() -> FloatArray:
    T = np.eye(4)
    T[1, 3] = np.nan
    return T


BAD_POSES = pytest.mark.parametrize("T", [skewed(), mirrored(), not_a_number()], ids=["skewed", "mirrored", "nan"])
BAD_COVARIANCES = pytest.mark.parametrize(
    "scale", [-1.0, 0.0, np.nan, np.inf], ids=["negative", "singular", "nan", "inf"]
)


@BAD_POSES
def test_a_transform_that_is_none_is_refused_by_name(T):
    with pytest.raises(FactorGraphError, match="keyframe 17"):
        FactorGraph(PLAIN).add_first_keyframe(17, T)
    graph = build(noisy_edges(), [])
    with pytest.raises(FactorGraphError, match="3 -> 8"):
        graph.add_edge(edge(3, 8, T))
    with pytest.raises(FactorGraphError, match="12"):
        graph.add_next_keyframe(edge(11, 12, T))
    assert graph.optimize().converged
    assert graph.keyframes.tolist() == list(range(KEYFRAMES))


@BAD_COVARIANCES
def test_a_covariance_that_is_none_is_refused_by_name(scale):
    graph = build(noisy_edges(), sightings())
    with pytest.raises(FactorGraphError, match="3 -> 8"):
        graph.add_edge(Edge(3, 8, np.eye(4), np.diag([1, 1, 1, 1, 1, scale]), "odometry"))
    with pytest.raises(FactorGraphError, match="landmark 4 from keyframe 2"):
        graph.add_observations([Observation(2, 4, np.array([5.0, 0, 0]), np.diag([1.0, scale, 1.0]))])
    assert graph.optimize().converged
    assert_is_true(graph)


def test_a_refused_observation_leaves_no_landmark_behind():
    graph = build(noisy_edges(), [])
    with pytest.raises(FactorGraphError):
        graph.add_observations([Observation(2, 4, np.array([5.0, 0, 0]), -np.eye(3))])
    assert graph.landmarks.tolist() == []
    graph.add_observations([Observation(2, 5, np.array([5.0, 0, 0]), SEEN_COVARIANCE)])
    assert graph.optimize().converged
    assert graph.landmarks.tolist() == [5]


def test_a_refused_keyframe_leaves_none_behind():
    graph = build(noisy_edges(), [])
    with pytest.raises(FactorGraphError):
        graph.add_next_keyframe(replace(edge(11, 12, np.eye(4)), covariance=-np.eye(6)))
    graph.add_next_keyframe(edge(11, 12, np.eye(4)))
    assert graph.optimize().converged
    assert graph.keyframes.tolist() == list(range(KEYFRAMES + 1))


def test_a_position_that_is_no_number_is_refused_by_name():
    graph = build(noisy_edges(), [])
    with pytest.raises(FactorGraphError, match="landmark 4"):
        graph.add_observations([Observation(2, 4, np.array([np.nan, 0, 0]), SEEN_COVARIANCE)])


def test_a_covariance_of_the_wrong_size_is_refused():
    with pytest.raises(FactorGraphError, match="6 x 6"):
        build(noisy_edges(), []).add_edge(Edge(3, 8, np.eye(4), np.eye(3), "odometry"))


def test_an_edge_to_a_keyframe_that_is_not_there_names_it():
    graph = build(noisy_edges(), [])
    with pytest.raises(FactorGraphError, match="keyframe 40"):
        graph.add_edge(edge(3, 40, np.eye(4)))
    assert graph.optimize().converged


def test_a_keyframe_that_nothing_holds_is_an_error_of_ours():
    graph = FactorGraph(PLAIN)
    with pytest.raises(FactorGraphError):
        graph.add_next_keyframe(edge(0, 1, np.eye(4)))


@pytest.mark.parametrize(
    "estimated",
    [
        False,
        True,
    ],
    ids=["incremental", "after the estimate was computed"],
)
def test_the_pose_of_an_unknown_keyframe_is_an_error_of_ours(estimated):
    graph = build(noisy_edges(), [])
    if estimated:
        graph.optimize()
    with pytest.raises(FactorGraphError, match="keyframe 40"):
        graph.pose(40)


def test_an_observation_from_an_unknown_keyframe_is_an_error_of_ours():
    graph = build(noisy_edges(), sightings())
    graph.optimize()
    with pytest.raises(FactorGraphError, match="keyframe 40"):
        graph.add_observations([Observation(40, 99, np.array([5.0, 0, 0]), SEEN_COVARIANCE)])


def test_an_unknown_landmark_is_an_error_of_ours():
    graph = build(noisy_edges(), sightings())
    with pytest.raises(FactorGraphError, match="landmark 40"):
        graph.landmark_positions(np.array([40]))
    with pytest.raises(FactorGraphError, match="landmark 40"):
        graph.landmark_covariances(np.array([40]))


def test_a_keyframe_added_twice_is_an_error_of_ours():
    graph = build(noisy_edges(), [])
    with pytest.raises(FactorGraphError, match="keyframe 5"):
        graph.add_next_keyframe(edge(4, 5, np.eye(4)))
    assert graph.keyframes.tolist() == list(range(KEYFRAMES))


def test_landmarks_may_stand_for_others_and_for_themselves_again():
    parts = {0: OFTEN_SEEN, 1: 98, 2: 99}
    split = [replace(o, landmark=parts[o.keyframe % 3]) if o.landmark == OFTEN_SEEN else o for o in sightings()]
    assert {98, 99, OFTEN_SEEN} <= {o.landmark for o in split}
    graph, untouched = build(noisy_edges(), split), build(noisy_edges(), split)
    graph.alias_landmarks({OFTEN_SEEN: 98, 99: 98})
    graph.update()
    assert {99, OFTEN_SEEN}.isdisjoint(graph.landmarks.tolist())
    graph.alias_landmarks({OFTEN_SEEN: 99})
    assert {98, 99} <= set(graph.landmarks.tolist())
    assert OFTEN_SEEN not in graph.landmarks.tolist()
    graph.alias_landmarks({})
    assert graph.landmarks.tolist() == untouched.landmarks.tolist()
    graph.optimize()
    untouched.optimize()
    assert_same_estimate(graph, untouched, atol=1e-4)


def test_a_landmark_that_comes_and_goes_between_two_updates_was_never_there() -> None:
    edges, observations = noisy_edges(), sightings()
    graph, twin = build(edges, observations), build(edges, observations)
    seen = np.array([3.0, 1.0, 0.5])
    graph.add_observations([Observation(k, 99, seen, SEEN_COVARIANCE) for k in (3, 4)])
    graph.remove_landmarks([99])
    graph.update()
    assert 99 not in graph.landmarks
    np.testing.assert_array_equal(graph.poses(), twin.poses())


def test_a_landmark_that_leaves_and_comes_again_between_two_updates_is_estimated() -> None:
    edges, observations = noisy_edges(), sightings()
    graph = build(edges, observations)
    of_landmark = [o for o in observations if o.landmark == observations[0].landmark]
    graph.remove_landmarks([of_landmark[0].landmark])
    graph.add_observations(of_landmark)
    graph.update()
    assert_is_true(graph)


def test_a_keyframe_is_placed_by_the_better_estimate_until_the_next_update() -> None:
    T = true_poses()
    graph = FactorGraph(PLAIN)
    graph.add_first_keyframe(0, T[0])
    graph.add_next_keyframe(noisy_edges()[0], invert(T[0]) @ T[1])
    np.testing.assert_allclose(graph.pose(1), T[1], atol=1e-9)
    graph.update()
    np.testing.assert_allclose(graph.pose(1), T[0] @ noisy_edges()[0].T_from_to, atol=1e-4)
