"""The factor graph: the truth recovered from wrong initial values, what is refused, and factors taken out and moved.

Each test of the estimate has a twin with one factor corrupted, in which the same check must fail.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slam.backend.factor_graph import FactorGraph
from slam.backend.factors import MIN_RANGE_RANGES, Edge, EdgeKind, Observation
from slam.common.arrays import FloatArray
from slam.common.config import FactorGraphConfig
from slam.common.errors import FactorGraphError
from slam.common.geometry import apply, invert, make_transform, transform_from_xyz_yaw

PLAIN = FactorGraphConfig(observation_kernel="none", observed_keyframes=1)
EDGE_COVARIANCE = np.diag(np.repeat([0.05**2, 0.2**2], 3))
SEEN_COVARIANCE = 0.02**2 * np.eye(3)
KEYFRAMES, LANDMARKS = 12, 15
OFTEN_SEEN = 7


def true_poses() -> FloatArray:
    """A round of 12 keyframes on a circle of 8 m, with some tilt and height."""
    around = 2 * np.pi * np.arange(KEYFRAMES) / KEYFRAMES
    xyz = np.stack([8 * np.sin(around), 8 - 8 * np.cos(around), 0.5 * np.sin(2 * around)], axis=1)
    tilt = make_transform(
        Rotation.from_euler("y", 0.05 * np.sin(around)[:, None]).as_matrix(), np.zeros((KEYFRAMES, 3))
    )
    return transform_from_xyz_yaw(xyz, around) @ tilt


def true_landmarks() -> FloatArray:
    return np.random.default_rng(0).uniform([-14, -6, -1], [14, 22, 3], (LANDMARKS, 3))


def edge(a: int, b: int, T: FloatArray, kind: str = "odometry") -> Edge:
    return Edge(a, b, T, EDGE_COVARIANCE, kind)


def noisy_edges(seed: int = 1) -> list[Edge]:
    """Odometry that is wrong by 0.2 m and 3 deg a step, so that its chain, the initial values, is metres off."""
    rng = np.random.default_rng(seed)
    T = true_poses()
    edges = []
    for i in range(KEYFRAMES - 1):
        error = make_transform(
            Rotation.from_rotvec(rng.normal(scale=0.05, size=3)).as_matrix(), rng.normal(scale=0.2, size=3)
        )
        edges.append(edge(i, i + 1, invert(T[i]) @ T[i + 1] @ error))
    return edges


def sightings(seed: int = 2, sigma_m: float = 0.005) -> list[Observation]:
    """Each keyframe sees the eight landmarks nearest to it."""
    rng = np.random.default_rng(seed)
    found = []
    for k, T in enumerate(true_poses()):
        seen = apply(invert(T), true_landmarks())
        for row in np.argsort(np.linalg.norm(seen, axis=1))[:8].tolist():
            found.append(Observation(k, row, seen[row] + rng.normal(scale=sigma_m, size=3), SEEN_COVARIANCE))
    return found


def build(edges: list[Edge], observations: list[Observation], config: FactorGraphConfig = PLAIN) -> FactorGraph:
    """The graph as a drive builds it: keyframe by keyframe, with an update after each."""
    graph = FactorGraph(config)
    graph.add_first_keyframe(0, true_poses()[0])
    for k in range(KEYFRAMES):
        if k > 0:
            graph.add_next_keyframe(edges[k - 1])
        graph.add_observations([o for o in observations if o.keyframe == k])
        graph.update()
    for extra in edges[KEYFRAMES - 1 :]:
        graph.add_edge(extra)
    graph.update()
    return graph


def worst_pose_error_m(graph: FactorGraph) -> float:
    return float(np.linalg.norm(graph.poses()[:, :3, 3] - true_poses()[:, :3, 3], axis=1).max())


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
    np.testing.assert_allclose(
        a.landmark_covariances(a.landmarks), b.landmark_covariances(b.landmarks), atol=atol, rtol=1e-3
    )


@pytest.mark.parametrize("kernel", ["none", "huber", "cauchy"])
def test_the_truth_is_recovered_from_initial_values_that_are_metres_off(kernel):
    config = FactorGraphConfig(observed_keyframes=1, observation_kernel=kernel, observation_kernel_width=30.0)
    assert worst_pose_error_m(build(noisy_edges(), [], config)) > 1.0
    graph = build(noisy_edges(), sightings(), config)
    optimization = graph.optimize()
    assert optimization.converged
    assert optimization.error_after <= optimization.error_before
    assert_is_true(graph)


def test_a_rough_solution_takes_fewer_steps_and_leads_to_the_same_one():
    config = FactorGraphConfig(observed_keyframes=1, observation_kernel="cauchy")
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
    graph = build(exact, observations, FactorGraphConfig(observation_kernel="cauchy", observed_keyframes=1))
    graph.optimize()
    assert_is_true(graph)


def test_the_incremental_and_the_batch_estimate_agree():
    graph = build(
        noisy_edges(),
        sightings(),
        FactorGraphConfig(observation_kernel="none", observed_keyframes=1, relinearize_skip=1),
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


def test_twin_a_closure_the_wrong_way_round_does_not_close():
    T = true_poses()
    backwards = replace(edge(11, 0, invert(T[0]) @ T[11], "closure"), covariance=1e-6 * np.eye(6))
    graph = build([*noisy_edges(), backwards], [])
    graph.optimize()
    assert np.linalg.norm(graph.pose(11)[:3, 3] - T[11, :3, 3]) > 0.5


# Noise


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
def test_bearing_and_range_cost_what_the_cartesian_covariance_says(seed):
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=3)
    position = 25.0 * direction / np.linalg.norm(direction)
    covariance = sight_covariance(position, *rng.uniform(0.05, 0.3, size=2))
    off = rng.multivariate_normal(np.zeros(3), 0.01 * covariance)
    expected = off @ np.linalg.solve(covariance, off)
    np.testing.assert_allclose(chi_squared_of(position, off, covariance), expected, rtol=0.02)
    np.testing.assert_allclose(chi_squared_of(position, off, covariance, 4.0), 0.25 * expected, rtol=0.02)


STRAIGHT_AHEAD = [(20.0, 0.01, 0.02), (20.0, 0.1, 0.05), (0.01, 15.0, 0.02), (0.02, -0.01, 10.0)]


@pytest.mark.parametrize("position", STRAIGHT_AHEAD)
def test_noise_that_differs_across_the_line_of_sight_counts_as_its_mean(position):
    """Small errors here change which coordinate of the direction is the smallest, and with it GTSAM's tangent axes."""
    position = np.array(position)
    covariance = np.diag([0.1, 0.5, 0.02]) ** 2
    along = position @ covariance @ position / (position @ position)
    even = sight_covariance(position, np.sqrt(along), np.sqrt(0.5 * (np.trace(covariance) - along)))
    for off in 0.2 * np.array([[0.0, 0.1, 0.0], [0.0, -0.12, 0.0], [0.03, 0.1, -0.02]]):
        expected = off @ np.linalg.solve(even, off)
        np.testing.assert_allclose(chi_squared_of(position, off, covariance), expected, rtol=0.05)


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


# Landmarks come and go


@pytest.mark.parametrize("sensor_range_m", [1.5, 30.0, 600.0])
def test_an_object_on_top_of_the_sensor_is_passed_over(sensor_range_m):
    graph = FactorGraph(PLAIN, sensor_range_m=sensor_range_m)
    graph.add_first_keyframe(0, np.eye(4))
    least_m = MIN_RANGE_RANGES * sensor_range_m
    near, far = np.array([0.99 * least_m, 0, 0]), np.array([0, 1.01 * least_m, 0])
    assert graph.add_observations([Observation(0, 50, near, SEEN_COVARIANCE)]) == 0
    assert graph.add_observations([Observation(0, 51, np.zeros(3), SEEN_COVARIANCE)]) == 0
    assert graph.add_observations([Observation(0, 52, far, SEEN_COVARIANCE)]) == 1
    graph.update()
    assert graph.landmarks.tolist() == [52]


@pytest.mark.parametrize(
    "covariance_inflation",
    [1.0, 50.0],
)
def test_merged_landmarks_are_as_if_all_had_seen_one(covariance_inflation):
    observations = [replace(o, covariance_inflation=covariance_inflation) for o in sightings()]
    split = [replace(o, landmark=99) if o.landmark == OFTEN_SEEN and o.keyframe % 2 else o for o in observations]
    assert sum(o.landmark == 99 for o in split) > 1
    merged, whole = build(noisy_edges(), split), build(noisy_edges(), observations)
    merged.merge_landmarks(OFTEN_SEEN, 99)
    merged.optimize()
    whole.optimize()
    assert_same_estimate(merged, whole, atol=1e-4)


def test_a_removed_landmark_is_as_if_it_had_never_been_seen():
    without = [o for o in sightings() if o.landmark not in (2, 4)]
    graph, reference = build(noisy_edges(), sightings()), build(noisy_edges(), without)
    graph.remove_landmark(2)
    graph.remove_landmark(4)
    graph.remove_landmark(77)
    graph.optimize()
    reference.optimize()
    assert_same_estimate(graph, reference, atol=1e-4)
    assert all(not isinstance(f, Observation) or f.landmark not in (2, 4) for f in graph.factors.values())


def test_a_landmark_removed_before_any_update_leaves_nothing_behind():
    graph = build(noisy_edges(), [])
    graph.add_observations([Observation(3, 1, np.array([5.0, 0, 0]), SEEN_COVARIANCE)])
    graph.remove_landmark(1)
    graph.update()
    assert graph.landmarks.tolist() == []
    assert graph.optimize().converged


@pytest.mark.parametrize(
    "update_between",
    [True, False],
)
def test_a_removed_landmark_may_be_seen_again(update_between):
    graph = build(noisy_edges(), sightings())
    graph.remove_landmark(4)
    if update_between:
        graph.update()
    graph.add_observations([o for o in sightings() if o.landmark == 4])
    graph.optimize()
    assert_is_true(graph)


def test_a_removed_edge_is_in_force_no_longer():
    graph = build(noisy_edges(), sightings())
    tight = Edge(0, 6, np.eye(4), 1e-6 * np.eye(6), "odometry")
    number = graph.add_edge(tight)
    graph.optimize()
    with pytest.raises(AssertionError):
        assert_is_true(graph)
    graph.remove_factor(number)
    graph.optimize()
    assert_is_true(graph)
    assert number not in graph.factors


def test_an_update_with_nothing_new_changes_nothing():
    graph = build(noisy_edges(), sightings())
    before = graph.poses()
    graph.update()
    graph.update()
    np.testing.assert_array_equal(graph.poses(), before)
    FactorGraph(PLAIN).update()


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


def test_an_edge_is_of_a_kind_that_logs_know():
    assert edge(0, 1, np.eye(4), "closure").kind is EdgeKind.LOOP_CLOSURE
    with pytest.raises(ValueError, match="guess"):
        edge(0, 1, np.eye(4), "guess")


def test_the_record_of_a_graph_without_edges_and_observations():
    graph = FactorGraph(PLAIN)
    graph.add_first_keyframe(0, np.eye(4))
    graph.optimize()
    record = graph.to_record(0, np.array([1]))
    assert record.edge_transforms.shape == (0, 4, 4)
    assert record.edge_keyframe_ids.shape == (0, 2)
    assert record.observation_positions.shape == (0, 3)
    assert graph.landmark_positions(graph.landmarks).shape == (0, 3)
    assert graph.landmark_covariances(graph.landmarks).shape == (0, 3, 3)


# What is refused


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


def test_a_chain_of_merges_can_be_undone():
    parts = {0: OFTEN_SEEN, 1: 98, 2: 99}
    split = [replace(o, landmark=parts[o.keyframe % 3]) if o.landmark == OFTEN_SEEN else o for o in sightings()]
    assert {98, 99, OFTEN_SEEN} <= {o.landmark for o in split}
    graph, untouched = build(noisy_edges(), split), build(noisy_edges(), split)
    graph.merge_landmarks(99, OFTEN_SEEN)
    graph.merge_landmarks(98, 99)
    graph.update()
    assert {99, OFTEN_SEEN}.isdisjoint(graph.landmarks.tolist())
    graph.undo_merge()
    assert 99 in graph.landmarks.tolist()
    assert OFTEN_SEEN not in graph.landmarks.tolist()
    graph.undo_merge()
    assert graph.landmarks.tolist() == untouched.landmarks.tolist()
    graph.optimize()
    untouched.optimize()
    assert_same_estimate(graph, untouched, atol=1e-4)
    with pytest.raises(FactorGraphError, match="no merge can be undone"):
        graph.undo_merge()


def test_a_landmark_that_comes_and_goes_between_two_updates_was_never_there() -> None:
    edges, observations = noisy_edges(), sightings()
    graph, twin = build(edges, observations), build(edges, observations)
    seen = np.array([3.0, 1.0, 0.5])
    graph.add_observations([Observation(k, 99, seen, SEEN_COVARIANCE) for k in (3, 4)])
    graph.remove_landmark(99)
    graph.update()
    assert 99 not in graph.landmarks
    np.testing.assert_array_equal(graph.poses(), twin.poses())


def test_a_landmark_that_leaves_and_comes_again_between_two_updates_is_estimated() -> None:
    edges, observations = noisy_edges(), sightings()
    graph = build(edges, observations)
    of_landmark = [o for o in observations if o.landmark == observations[0].landmark]
    graph.remove_landmark(of_landmark[0].landmark)
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


def test_the_batch_solution_uses_the_observations_that_the_incremental_estimate_left_out() -> None:
    sparse = PLAIN.model_copy(update={"observed_keyframes": KEYFRAMES})
    graph, twin = (build(noisy_edges(), sightings(), config) for config in (sparse, PLAIN))
    assert len(graph.estimates().landmarks) < len(twin.estimates().landmarks)
    graph.optimize()
    twin.optimize()
    assert_is_true(graph)
    np.testing.assert_allclose(graph.poses(), twin.poses(), atol=1e-4)
    np.testing.assert_allclose(
        graph.landmark_positions(graph.landmarks), twin.landmark_positions(twin.landmarks), atol=1e-3
    )


# Segments that a closure joins


def test_what_only_a_break_tied_is_moved_as_a_whole_to_where_the_closure_puts_it():
    graph = FactorGraph(PLAIN)
    tight, loose = np.diag(np.repeat([1e-6, 1e-4], 3)), np.diag(np.repeat([1.0, 1e4], 3))
    step = transform_from_xyz_yaw(np.array([2.0, 0.0, 0.0]), 0.0)
    graph.add_first_keyframe(0, np.eye(4))
    graph.add_next_keyframe(Edge(0, 1, step, tight, EdgeKind.ODOMETRY))
    graph.add_next_keyframe(Edge(1, 2, np.eye(4), loose, EdgeKind.DISCONTINUITY))
    graph.add_next_keyframe(Edge(2, 3, step, tight, EdgeKind.ODOMETRY))
    seen = [(0, 5, [4.0, 3.0, 0.0]), (1, 5, [2.0, 3.0, 0.0]), (2, 6, [4.0, 3.0, 0.0]), (3, 6, [2.0, 3.0, 0.0])]
    graph.add_observations([Observation(k, row, np.array(at), SEEN_COVARIANCE) for k, row, at in seen])
    graph.update()
    T_far = transform_from_xyz_yaw(np.array([-60.0, 45.0, 0.0]), 2.5)
    graph.add_joining_edge(Edge(0, 2, T_far, tight, EdgeKind.LOOP_CLOSURE), np.array([2, 3]))
    (break_now,) = (f for f in graph.factors.values() if isinstance(f, Edge) and f.kind == EdgeKind.DISCONTINUITY)
    np.testing.assert_allclose(break_now.T_from_to, invert(step) @ T_far, atol=0.01)
    np.testing.assert_allclose(graph.pose(3), T_far @ step, atol=0.1)
    np.testing.assert_allclose(graph.landmark_positions(np.array([5])), [[4.0, 3.0, 0.0]], atol=1e-6)
    graph.optimize()
    expected = [[4.0, 3.0, 0.0], apply(T_far, np.array([[4.0, 3.0, 0.0]]))[0]]
    np.testing.assert_allclose(graph.landmark_positions(np.array([5, 6])), expected, atol=1e-3)
    np.testing.assert_allclose(graph.pose(3), T_far @ step, atol=1e-3)


def test_an_edge_that_joins_segments_bends_neither():
    """Both segments are as straight after the joining as before, though the edge was far from the first estimate."""
    graph = FactorGraph(PLAIN)
    soft, loose = np.diag(np.repeat([1e-2, 1.0], 3)), np.diag(np.repeat([1.0, 1e4], 3))
    step = transform_from_xyz_yaw(np.array([2.0, 0.0, 0.0]), 0.0)
    graph.add_first_keyframe(0, np.eye(4))
    graph.add_next_keyframe(Edge(0, 1, step, soft, EdgeKind.ODOMETRY))
    graph.add_next_keyframe(Edge(1, 2, np.eye(4), loose, EdgeKind.DISCONTINUITY))
    graph.add_next_keyframe(Edge(2, 3, step, soft, EdgeKind.ODOMETRY))
    T_far = transform_from_xyz_yaw(np.array([3.0, 2.5, 0.0]), 0.4)
    number = graph.add_joining_edge(Edge(0, 3, T_far, soft, EdgeKind.LOOP_CLOSURE), np.array([2, 3]))
    np.testing.assert_allclose(graph.poses(), [np.eye(4), step, T_far @ invert(step), T_far], atol=1e-9)
    graph.remove_factor(number)
    graph.update()
    assert number not in graph.factors


def test_an_edge_whose_covariance_is_replaced_counts_by_the_new_one():
    T_0_1 = transform_from_xyz_yaw(np.array([1.0, 0.0, 0.0]), 0.0)
    graph = FactorGraph(PLAIN)
    graph.add_first_keyframe(0, np.eye(4))
    graph.add_next_keyframe(Edge(0, 1, T_0_1, 0.01 * np.eye(6), "odometry"))
    other = transform_from_xyz_yaw(np.array([2.0, 0.0, 0.0]), 0.0)
    graph.add_edge(Edge(0, 1, other, 0.01 * np.eye(6), "odometry"))
    graph.optimize()
    assert graph.pose(1)[0, 3] == pytest.approx(1.5, abs=1e-3)
    first = min(number for number, each in graph.factors.items() if isinstance(each, Edge))
    graph.replace_covariances({first: 0.03 * np.eye(6)})
    graph.optimize()
    assert graph.pose(1)[0, 3] == pytest.approx(1.75, abs=1e-3)
    assert graph.factors[first].covariance[0, 0] == 0.03
