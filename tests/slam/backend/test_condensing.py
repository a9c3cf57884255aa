"""Keyframes of later traversals attached to earlier ones: the same map with fewer variables."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X

from slam.backend.factor_graph import FactorGraph
from slam.backend.factors import AttachedKeyframes, Edge, Observation, between_factor
from slam.common.arrays import FloatArray
from slam.common.geometry import invert, relative
from tests.helpers.graphs import chained, observed_from, odometry_edges
from tests.helpers.poses import motion_by, pose_at
from tests.logs.examples import random_covariance
from tests.slam.backend import graphs
from tests.slam.backend.graphs import KEYFRAMES, LANDMARKS, SEEN_COVARIANCE, true_landmarks, worst_pose_error_m

ROUND = KEYFRAMES
STEP_COVARIANCE = np.diag(np.repeat([0.02**2, 0.05**2], 3))


def true_poses(rounds: int) -> FloatArray:
    """Each round is a little beside the one before, and looks elsewhere."""
    aside = [pose_at(0.0, -0.3 * lap, z=0.1 * lap, yaw=0.4 * lap) for lap in range(rounds)]
    return np.concatenate([graphs.true_poses() @ T for T in aside])


def driven(rounds: int) -> FactorGraph:
    """Rounds in which each keyframe sees the eight landmarks nearest to it."""
    T, rng = true_poses(rounds), np.random.default_rng(1)
    errors = rng.normal(size=(len(T), 6)) * np.sqrt(np.diag(STEP_COVARIANCE))
    edges = odometry_edges(T, STEP_COVARIANCE)
    noisy = [
        replace(each, T_from_to=each.T_from_to @ motion_by(off[:3], off[3:]))
        for each, off in zip(edges, errors, strict=False)
    ]
    return graphs.build(noisy, graphs.sightings(1, 0.02, T), keyframes=len(T))


def anchors_of(rounds: range) -> dict[int, int]:
    """Those of the keyframes of later rounds: the keyframes of the second one."""
    keyframes = range(rounds.start * ROUND, rounds.stop * ROUND)
    return {keyframe: ROUND + keyframe % ROUND for keyframe in keyframes}


def condensed(rounds: int, *, settled: int | None = None) -> FactorGraph:
    graph = driven(rounds)
    graph.optimize()
    graph.condense(anchors_of(range(2, settled or rounds)))
    return graph


def test_observations_of_all_rounds_count():
    truth = true_landmarks()

    def sigma_m(graph: FactorGraph) -> float:
        graph.optimize()
        assert np.linalg.norm(graph.landmark_positions(graph.landmarks) - truth[graph.landmarks], axis=1).max() < 0.1
        return float(np.sqrt(np.trace(graph.covariances()[1], axis1=1, axis2=2).mean() / 3.0))

    once, whole, attached = sigma_m(driven(1)), sigma_m(driven(6)), sigma_m(condensed(6))
    assert 0.5 * whole < attached < 1.1 * whole < once


def test_the_drive_goes_on_from_a_condensed_graph():
    graph = condensed(4, settled=3)
    T, landmarks = true_poses(5), true_landmarks()
    for k in range(4 * ROUND, 5 * ROUND):
        graph.add_next_keyframe(Edge(k - 1, k, relative(T[k - 1], T[k]), STEP_COVARIANCE, "odometry"))
        graph.add_observations(observed_from(k, T[k], landmarks, range(LANDMARKS), SEEN_COVARIANCE))
        graph.update()
    graph.optimize()
    assert worst_pose_error_m(graph, T) < 0.1
    graph.condense(anchors_of(range(3, 5)))
    assert len(graph.keyframe_variables) == 2 * ROUND
    assert worst_pose_error_m(graph, T) < 0.1


def test_closures_to_an_attached_keyframe_pull_at_its_anchor():
    graph = condensed(3)
    attached = (set(graph.keyframes.tolist()) - set(graph.keyframe_variables.tolist())).pop()
    T_true = true_poses(3)[attached] @ pose_at(1.0, 2.0, yaw=0.3)
    graph.add_keyframe(99, np.eye(4))
    closure = relative(true_poses(3)[attached], T_true)
    graph.add_edge(Edge(attached, 99, closure, 1e-4 * np.eye(6), "closure"))
    graph.optimize()
    np.testing.assert_allclose(relative(graph.pose(attached), graph.pose(99)), closure, atol=1e-6)
    np.testing.assert_allclose(graph.pose(99)[:3, 3], T_true[:3, 3], atol=0.1)


def test_merged_landmarks_can_be_condensed_and_removed():
    graph = driven(3)
    graph.optimize()
    graph.alias_landmarks({1: 0})
    graph.condense(anchors_of(range(2, 3)))
    graph.remove_landmarks([0, 1])
    graph.optimize()
    assert not {0, 1} & set(graph.landmarks.tolist())


def test_edges_to_keyframes_that_stay_remain():
    step = pose_at(1.0)
    graph = chained(np.eye(4), [Edge(k, k + 1, step, STEP_COVARIANCE, "odometry") for k in range(5)])
    graph.add_edge(Edge(1, 3, step @ step, STEP_COVARIANCE, "closure"))
    graph.add_edge(Edge(4, 5, step, STEP_COVARIANCE, "closure"))
    graph.condense({3: 1, 4: 2})
    edges = [each for each in graph.factors.values() if isinstance(each, Edge)]
    assert [(each.from_keyframe, each.to_keyframe, each.kind) for each in edges] == [
        (0, 1, "odometry"),
        (1, 2, "odometry"),
        (2, 1, "condensed"),
        (2, 5, "condensed"),
        (2, 5, "closure"),
    ]
    np.testing.assert_allclose(graph.poses()[:, 0, 3], np.arange(6.0), atol=1e-6)


def test_the_record_holds_all_keyframes_and_ties_each_to_its_anchor():
    graph = condensed(3)
    record = graph.to_record(0, np.arange(3 * ROUND), graph.covariances()[0])
    kinds = np.array(record.edge_kinds)
    attached = set(range(3 * ROUND)) - set(graph.keyframe_variables.tolist())
    assert attached
    assert attached <= set(record.edge_keyframe_ids[kinds == "condensed"][:, 1].tolist())
    assert not attached & set(record.observation_keyframe_ids.tolist())
    assert record.pose_covariances.shape == (3 * ROUND, 6, 6)
    assert (np.linalg.eigvalsh(record.pose_covariances) > 0.0).all()


def attached_at(T_anchor_keyframe: FloatArray) -> AttachedKeyframes:
    attached = AttachedKeyframes()
    poses = {1: np.eye(4), 2: T_anchor_keyframe}
    attached.attach({2: 1}, {2: np.eye(6)}, lambda keyframe: poses[keyframe])
    return attached


@pytest.mark.parametrize("ends", [(2, 3), (3, 2)])
def test_an_edge_of_an_attached_keyframe_has_the_error_that_it_had(ends):
    rng = np.random.default_rng(3)
    T_1, T_1_2, T_from_to = (gtsam.Pose3.Expmap(rng.normal(size=6)).matrix() for _ in range(3))
    edge = Edge(ends[0], ends[1], T_from_to, random_covariance(rng, 6), "odometry")
    # Near what it says, where errors are linear.
    T_2_3 = T_from_to if ends == (2, 3) else invert(T_from_to)
    T_2_3 = T_2_3 @ gtsam.Pose3.Expmap(1e-4 * rng.normal(size=6)).matrix()
    values = gtsam.Values()
    for keyframe, T in enumerate((T_1, T_1 @ T_1_2, T_1 @ T_1_2 @ T_2_3), start=1):
        values.insert(X(keyframe), gtsam.Pose3(T))
    moved = attached_at(T_1_2).edge(edge)
    assert {moved.from_keyframe, moved.to_keyframe} == {1, 3}
    assert between_factor(moved).error(values) == pytest.approx(between_factor(edge).error(values), rel=1e-3)


def test_an_observation_is_turned_with_its_noise():
    quarter = pose_at(1.0, 2.0, z=3.0, yaw=np.pi / 2)
    seen = Observation(2, 7, np.array([5.0, 0.0, 0.0]), np.diag([0.01, 0.04, 0.09]), 2.0)
    found = attached_at(quarter).observation(seen)
    assert (found.keyframe, found.landmark, found.covariance_inflation) == (1, 7, 2.0)
    np.testing.assert_allclose(found.position, [1.0, 7.0, 3.0], atol=1e-12)
    np.testing.assert_allclose(found.covariance, np.diag([0.04, 0.01, 0.09]), atol=1e-12)
