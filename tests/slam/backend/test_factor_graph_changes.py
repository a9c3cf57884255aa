"""The factor graph: landmarks that are merged and removed, edges that go, segments that a closure joins."""

from dataclasses import replace

import numpy as np
import pytest

from slam.backend.factor_graph import FactorGraph
from slam.backend.factors import Edge, EdgeKind, Observation
from slam.backend.graph_record import observations_of
from slam.common.geometry import apply, invert, relative
from tests.helpers.graphs import PLAIN, chained, odometry_edges
from tests.helpers.poses import pose_at
from tests.slam.backend.graphs import (
    KEYFRAMES,
    OFTEN_SEEN,
    SEEN_COVARIANCE,
    assert_is_true,
    assert_same_estimate,
    build,
    noisy_edges,
    sightings,
    true_poses,
)


def test_a_removed_landmark_is_as_if_it_had_never_been_seen(graph):
    without = [o for o in sightings() if o.landmark not in (2, 4)]
    reference = build(noisy_edges(), without)
    graph.remove_landmarks([2, 4, 77])
    graph.optimize()
    reference.optimize()
    assert_same_estimate(graph, reference, atol=1e-4)
    assert all(not isinstance(f, Observation) or f.landmark not in (2, 4) for f in graph.factors.values())


def test_a_landmark_that_comes_and_goes_between_two_updates_was_never_there(graph):
    poses = graph.poses()
    seen = np.array([3.0, 1.0, 0.5])
    graph.add_observations([Observation(k, 99, seen, SEEN_COVARIANCE) for k in (3, 4)])
    graph.remove_landmarks([99])
    graph.update()
    assert 99 not in graph.landmarks
    np.testing.assert_array_equal(graph.poses(), poses)


def test_observed_positions_are_means_by_information_of_own_observations_only():
    graph = FactorGraph()
    T = pose_at(2.0, 1.0, yaw=0.5)
    graph.add_keyframe(0, T)
    near, far, other = np.array([4.0, 1.0, 0.0]), np.array([5.0, 3.0, 1.0]), np.array([9.0, 9.0, 9.0])
    graph.add_observations(
        [
            Observation(0, 5, near, SEEN_COVARIANCE),
            Observation(0, 5, far, SEEN_COVARIANCE, covariance_inflation=3.0),
            Observation(0, 6, other, SEEN_COVARIANCE),
        ]
    )
    graph.alias_landmarks({6: 5})
    mean = (3.0 * near + far) / 4.0
    np.testing.assert_allclose(
        graph.observed_positions(np.array([6, 5, 77])), [*apply(T, np.array([other, mean])), [np.nan] * 3]
    )
    assert np.isnan(graph.observed_positions(np.array([77, 78]))).all()


@pytest.mark.parametrize("update_between", [True, False])
def test_a_removed_landmark_may_be_seen_again(graph, update_between):
    graph.remove_landmarks([4])
    if update_between:
        graph.update()
    graph.add_observations([o for o in sightings() if o.landmark == 4])
    graph.optimize()
    assert_is_true(graph)


def test_a_removed_edge_is_in_force_no_longer(graph):
    tight = Edge(0, 6, np.eye(4), 1e-6 * np.eye(6), "condensed")
    number = graph.add_edge(tight)
    graph.optimize()
    with pytest.raises(AssertionError):
        assert_is_true(graph)
    graph.remove_factors([number])
    graph.optimize()
    assert_is_true(graph)
    assert number not in graph.factors


def test_an_update_with_nothing_new_changes_nothing(graph):
    before = graph.poses()
    graph.update()
    graph.update()
    np.testing.assert_array_equal(graph.poses(), before)
    FactorGraph(kernel_width=PLAIN).update()


def test_the_record_holds_the_graph():
    observations = [replace(o, covariance_inflation=3.0) for o in sightings()]
    graph = build(noisy_edges(), observations)
    graph.optimize()
    record = graph.to_record(9, np.arange(KEYFRAMES))
    assert record.keyframe_ids.tolist() == list(range(KEYFRAMES))
    np.testing.assert_array_equal(record.T_map_body, graph.poses())
    assert record.edge_keyframe_ids.tolist() == [[i, i + 1] for i in range(KEYFRAMES - 1)]
    assert record.edge_kinds == ("odometry",) * (KEYFRAMES - 1)
    assert list(zip(record.observation_keyframe_ids.tolist(), record.observation_landmark_ids, strict=True)) == [
        (o.keyframe, str(o.landmark)) for o in observations
    ]
    np.testing.assert_allclose(record.observation_covariances[0], 3.0 * SEEN_COVARIANCE)
    again = observations_of(
        record, dict(enumerate(range(KEYFRAMES))), {str(o.landmark): o.landmark for o in observations}
    )
    assert {each.covariance_inflation for each in again} == {3.0}
    np.testing.assert_allclose(again[0].covariance, SEEN_COVARIANCE)


def test_the_record_of_a_graph_without_edges_and_observations():
    graph = chained(np.eye(4), [])
    graph.optimize()
    record = graph.to_record(0, np.array([1]))
    assert record.edge_transforms.shape == (0, 4, 4)
    assert record.edge_keyframe_ids.shape == (0, 2)
    assert record.observation_positions.shape == (0, 3)
    assert graph.landmark_positions(graph.landmarks).shape == (0, 3)
    assert graph.covariances()[1].shape == (0, 3, 3)


@pytest.mark.parametrize("ends", [(0, 3), (3, 0)])
def test_a_joining_edge_moves_its_segment_as_a_whole(ends):
    """Neither segment is bent, though the edge is far from the first estimate; the break is what it is now."""
    soft, loose = np.diag(np.repeat([1e-2, 1.0], 3)), np.diag(np.repeat([1.0, 1e4], 3))
    step = pose_at(2.0)
    edges = [
        Edge(0, 1, step, soft, EdgeKind.ODOMETRY),
        Edge(1, 2, np.eye(4), loose, EdgeKind.DISCONTINUITY),
        Edge(2, 3, step, soft, EdgeKind.ODOMETRY),
    ]
    first, second = np.array([[4.0, 3.0, 0.0], [2.0, 3.0, 0.0]])
    seen = [Observation(k, 5 + k // 2, at, SEEN_COVARIANCE) for k, at in enumerate([first, second] * 2)]
    graph = chained(np.eye(4), edges, seen)
    T_far = pose_at(-60.0, 45.0, yaw=2.5)
    T_ends = T_far if ends == (0, 3) else invert(T_far)
    number = graph.add_joining_edge(Edge(ends[0], ends[1], T_ends, soft, EdgeKind.LOOP_CLOSURE), {2, 3})
    poses = [np.eye(4), step, T_far @ invert(step), T_far]
    np.testing.assert_allclose(graph.poses(), poses, atol=1e-6)
    (break_now,) = (f for f in graph.factors.values() if isinstance(f, Edge) and f.kind == EdgeKind.DISCONTINUITY)
    np.testing.assert_allclose(break_now.T_from_to, invert(step) @ poses[2], atol=1e-6)
    expected = [first, apply(poses[2], first[None])[0]]
    np.testing.assert_allclose(graph.landmark_positions(np.array([5, 6])), expected, atol=1e-6)
    graph.remove_factors([number])
    graph.update()
    assert number not in graph.factors


def test_a_break_leaves_the_later_keyframes_to_the_odometry_after_it(graph):
    """Landmarks seen by both parts would pull them together again."""
    T_step, loose = pose_at(300.0), np.diag(np.repeat([1.0, 1e4], 3))
    graph.break_before(Edge(3, 4, T_step, loose, EdgeKind.DISCONTINUITY))
    graph.optimize()
    assert np.linalg.norm(relative(graph.pose(3), graph.pose(4))[:3, 3]) == pytest.approx(300.0, abs=0.01)
    assert {each.keyframe for each in graph.factors.values() if isinstance(each, Observation)} == {0, 1, 2, 3}


def test_an_edge_whose_covariance_is_replaced_counts_by_the_new_one():
    first, second = (Edge(0, 1, pose_at(x_m), 0.01 * np.eye(6), "condensed") for x_m in (1.0, 2.0))
    graph = chained(np.eye(4), [first])
    graph.add_edge(second)
    graph.optimize()
    assert graph.pose(1)[0, 3] == pytest.approx(1.5, abs=1e-3)
    number = min(number for number, each in graph.factors.items() if isinstance(each, Edge))
    graph.replace_edges({number: replace(first, covariance=0.03 * np.eye(6))})
    graph.optimize()
    assert graph.pose(1)[0, 3] == pytest.approx(1.75, abs=1e-3)
    assert graph.factors[number].covariance[0, 0] == 0.03


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


def test_a_keyframe_is_placed_by_the_better_estimate_until_the_next_update() -> None:
    T = true_poses()
    graph = chained(T[0], [])
    graph.add_next_keyframe(noisy_edges()[0], invert(T[0]) @ T[1])
    np.testing.assert_allclose([graph.pose(1), graph.poses()[1]], [T[1], T[1]], atol=1e-9)
    graph.update()
    np.testing.assert_allclose(graph.pose(1), T[0] @ noisy_edges()[0].T_from_to, atol=1e-4)


def test_closure_that_contradicts_the_odometry_is_kept():
    T = true_poses()
    edges = odometry_edges(T, 1e-4 * np.eye(6))
    edges[6] = replace(edges[6], T_from_to=edges[6].T_from_to @ pose_at(1.0, yaw=np.pi / 2.0))
    graph, errors_m = chained(T[0], edges), list[float]()
    closure = graph.add_edge(Edge(2, 9, relative(T[2], T[9]), 1e-3 * np.eye(6), EdgeKind.LOOP_CLOSURE))
    for solve in (graph.update, lambda: graph.settle(closure)):
        solve()
        errors_m.append(float(np.linalg.norm((graph.poses() - T)[9:, :3, 3], axis=1).max()))
    assert errors_m[0] > 5.0
    assert errors_m[1] < 0.5


def test_closure_that_agrees_leaves_the_incremental_estimate(monkeypatch):
    T = true_poses()
    graph = chained(T[0], odometry_edges(T, 1e-4 * np.eye(6)))
    monkeypatch.setattr("slam.backend.solver.Solver.optimize_anew", None)
    graph.settle(graph.add_edge(Edge(0, 11, relative(T[0], T[11]), 1e-2 * np.eye(6), EdgeKind.LOOP_CLOSURE)))


def test_a_step_that_the_landmarks_contradict_is_no_gaussian_one():
    edges = noisy_edges()
    edges[6] = replace(edges[6], T_from_to=edges[6].T_from_to @ pose_at(1.0, yaw=np.pi / 2.0))
    graph = build(edges, sightings())
    graph.assume_gaussian_odometry()
    assert [each.is_gaussian for each in graph.edges(EdgeKind.ODOMETRY).values()] == [k != 6 for k in range(11)]
    graph.match_noise()
    assert_is_true(graph)
    assert not any(each.is_gaussian for each in graph.edges(EdgeKind.ODOMETRY).values())
