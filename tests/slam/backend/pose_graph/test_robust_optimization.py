from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from slam.backend.pose_graph.pose_graph import PoseGraph
from slam.backend.pose_graph.pose_graph_optimization import PoseGraphSolution, optimize_pose_graph
from slam.backend.pose_graph.robust_optimization import (
    _could_be_lower,
    optimize_robustly,
)
from slam.common.errors import FactorGraphError
from slam.common.geometry import invert, transform_from_xyz_yaw
from tests.helpers.pose_graphs import (
    ROUND,
    VERTICES,
    are_closures,
    false_closures,
    rmse_m,
    true_closures,
    true_poses,
    two_rounds,
    with_false,
)

TRUE = 20
LOOSE = 0.1


def robust(graph: PoseGraph, **more: int) -> PoseGraphSolution:
    return optimize_pose_graph(graph, are_closures(graph), **more)


def plain(graph: PoseGraph) -> PoseGraphSolution:
    return optimize_pose_graph(graph, np.zeros(len(graph.edges), dtype=np.bool_))


def odometry_only() -> PoseGraph:
    return two_rounds(*(part[:0] for part in true_closures(1, np.random.default_rng(0))))


# What is solved


@pytest.mark.parametrize("false_share", [0.0, 0.3, 0.6, 0.75])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_false_closures_cost_nothing(false_share: float, seed: int) -> None:
    false_count = round(TRUE * false_share / (1.0 - false_share))
    graph = with_false(TRUE, false_count, seed=seed)
    clean = robust(with_false(TRUE, 0, seed=seed))
    solved = robust(graph)
    assert solved.solution.converged
    assert solved.solution.message == ""
    assert rmse_m(solved.graph) < 1.1 * rmse_m(clean.graph) + 0.01
    assert rmse_m(solved.graph) < 0.6 * rmse_m(odometry_only())
    assert np.mean(solved.solution.kept[:TRUE]) > 0.9
    assert np.all(solved.solution.weights[TRUE:] < 0.01)
    if false_count:  # the twin
        assert rmse_m(plain(graph).graph) > 5.0


def test_only_false_closures_leave_the_odometry_as_it_is() -> None:
    graph = with_false(0, 40)
    solved = robust(graph)
    assert solved.solution.converged
    assert "none of 40 closures agrees with the rest; all were rejected" in solved.solution.message
    np.testing.assert_array_equal(solved.solution.weights, np.zeros(40))
    np.testing.assert_allclose(solved.graph.T_world_vertex, odometry_only().T_world_vertex, atol=1e-6)
    assert rmse_m(plain(graph).graph) > 5.0


def drifted() -> PoseGraph:
    """The second round has slipped by 3 m, and five closures, of 17, say that it has not."""
    slip = transform_from_xyz_yaw(np.array([3.0, 0.0, 0.0]), 0.0)
    rng = np.random.default_rng(3)
    pairs, right = true_closures(12, rng)
    wrong_pairs, wrong = true_closures(5, rng)
    graph = two_rounds(np.concatenate([pairs, wrong_pairs]), np.concatenate([right, wrong]))
    slipped = ROUND - 1
    graph.T_from_to[slipped] = graph.T_from_to[slipped] @ slip
    graph.covariances[slipped] = np.diag(np.repeat([0.01, 3.0], 3) ** 2.0)
    poses = graph.T_world_vertex
    poses[ROUND:] = poses[slipped] @ graph.T_from_to[slipped] @ invert(poses[ROUND]) @ poses[ROUND:]
    graph.T_from_to[-5:] = invert(poses[wrong_pairs[:, 0]]) @ poses[wrong_pairs[:, 1]]
    return graph


def test_the_majority_wins_even_if_the_odometry_sides_with_the_minority() -> None:
    solved = robust(drifted())
    assert solved.solution.kept.tolist() == [True] * 12 + [False] * 5
    assert rmse_m(solved.graph) < 0.5


def test_a_graph_without_closures_is_solved_as_ever() -> None:
    graph = odometry_only()
    solved = robust(graph)
    assert solved.solution.converged
    assert solved.solution.weights.shape == (0,)
    np.testing.assert_allclose(solved.graph.T_world_vertex, graph.T_world_vertex, atol=1e-6)


def test_the_initial_values_hardly_matter() -> None:
    graph = with_false(TRUE, 30)
    wrong = replace(graph, T_world_vertex=plain(graph).graph.T_world_vertex)
    assert rmse_m(wrong) > 5.0
    np.testing.assert_allclose(robust(wrong).graph.T_world_vertex, robust(graph).graph.T_world_vertex, atol=0.01)


def test_the_same_graph_gives_the_same_bytes() -> None:
    first, second = (robust(with_false(TRUE, 30)) for _ in range(2))
    assert first.graph.T_world_vertex.tobytes() == second.graph.T_world_vertex.tobytes()
    assert first.solution.weights.tobytes() == second.solution.weights.tobytes()


def test_the_error_falls() -> None:
    solution = robust(with_false(TRUE, 30)).solution
    assert solution.error_after < 0.8 * solution.error_before
    assert solution.iterations > 0


def test_the_first_pose_stays_exactly_where_it_is() -> None:
    graph = with_false(10, 10)
    solved = robust(graph).graph
    np.testing.assert_array_equal(solved.T_world_vertex[0], graph.T_world_vertex[0])
    assert np.abs(solved.T_world_vertex[100] - graph.T_world_vertex[100]).max() > 0.01


def test_what_did_not_converge_is_told() -> None:
    solved = robust(with_false(TRUE, 30), max_iterations=1)
    assert not solved.solution.converged
    assert "closures took all 1 iterations" in solved.solution.message


# The graph that is given


def factors(graph: PoseGraph) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """Closures come first, and an empty slot is among the factors."""
    result, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    closures = are_closures(graph)
    for row in [*np.flatnonzero(closures), *np.flatnonzero(~closures)]:
        noise = gtsam.noiseModel.Gaussian.Covariance(graph.covariances[row])
        start, end = graph.edges[row].tolist()
        result.add(gtsam.BetweenFactorPose3(start, end, gtsam.Pose3(graph.T_from_to[row]), noise))
    for vertex, T in enumerate(graph.T_world_vertex):
        values.insert(vertex, gtsam.Pose3(T))
    prior = gtsam.PriorFactorPose3(0, gtsam.Pose3(true_poses()[0]), gtsam.noiseModel.Isotropic.Sigma(6, 1e-5))
    result.add(prior)
    result.add(prior)
    result.remove(result.size() - 1)
    return result, values


def test_other_factors_keep_their_kernels() -> None:
    """A wrong position of the last vertex is an outlier to a kernel, and is followed without one."""
    base, values = factors(with_false(TRUE, 10))
    count = TRUE + 10
    noise = gtsam.noiseModel.Isotropic.Sigma(3, 0.01)
    robust_noise = gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Cauchy.Create(1.0), noise)
    wrong = true_poses()[-1, :3, 3] + 30.0
    off_m = {}
    for name, model in {"kernel": robust_noise, "plain": noise}.items():
        graph = base.clone()
        graph.add(gtsam.PoseTranslationPrior3D(VERTICES - 1, gtsam.Pose3(gtsam.Rot3(), wrong), model))
        solution = optimize_robustly(graph, values, np.arange(count))
        off_m[name] = np.linalg.norm(solution.values.atPose3(VERTICES - 1).translation() - true_poses()[-1, :3, 3])
    assert off_m["kernel"] < 1.0
    assert off_m["plain"] > 10.0


def test_the_graph_and_the_values_are_not_changed() -> None:
    graph, values = factors(with_false(TRUE, 10))
    error, size = graph.error(values), graph.nrFactors()
    optimize_robustly(graph, values, np.arange(TRUE + 10))
    assert graph.error(values) == error
    assert graph.nrFactors() == size


def test_a_minimum_could_not_be_lower() -> None:
    graph, values = factors(with_false(TRUE, 0))
    parameters = gtsam.LevenbergMarquardtParams()
    assert _could_be_lower(graph, values, parameters)
    solved = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    assert not _could_be_lower(graph, solved, parameters)


def test_a_system_that_is_indeterminate_could_be_lower() -> None:
    """Two poses that only their difference connects: no full step exists."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.add(gtsam.BetweenFactorPose3(0, 1, gtsam.Pose3(), gtsam.noiseModel.Isotropic.Sigma(6, 1.0)))
    values.insert(0, gtsam.Pose3())
    values.insert(1, gtsam.Pose3())
    assert _could_be_lower(graph, values, gtsam.LevenbergMarquardtParams())


# What is refused


@pytest.mark.parametrize("index", [-1, 10_000])
def test_an_index_of_no_factor_is_refused(index: int) -> None:
    graph, values = factors(with_false(3, 0))
    with pytest.raises(FactorGraphError, match=f"factor {index} is not a closure"):
        optimize_robustly(graph, values, np.array([index]))


def test_an_empty_slot_and_a_prior_are_no_closures() -> None:
    graph, values = factors(with_false(3, 0))
    for index in (graph.size() - 1, graph.size() - 2):
        with pytest.raises(FactorGraphError, match=f"factor {index} is not a closure"):
            optimize_robustly(graph, values, np.array([index]))


def test_a_closure_with_a_kernel_is_refused() -> None:
    graph, values = factors(with_false(3, 0))
    kernel = gtsam.noiseModel.mEstimator.Huber.Create(1.0)
    graph.replace(
        1,
        graph.at(1).cloneWithNewNoiseModel(gtsam.noiseModel.Robust.Create(kernel, graph.at(1).noiseModel())),  # type: ignore[attr-defined]
    )
    with pytest.raises(FactorGraphError, match="closure 1 has a kernel"):
        optimize_robustly(graph, values, np.array([0, 1]))


def test_the_false_closures_of_these_tests_are_false() -> None:
    pairs, transforms = false_closures(50, np.random.default_rng(0))
    T_gt = true_poses()
    apart = np.linalg.norm(T_gt[pairs[:, 0], :3, 3] - T_gt[pairs[:, 1], :3, 3], axis=1)
    assert apart.min() > np.linalg.norm(transforms[:, :3, 3], axis=1).max()
    assert pairs.max() < VERTICES
    assert ROUND // 2 - 10 > 1
