"""Two rounds on a circle, with true closures between them and false ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slam.backend.factors import Edge, EdgeKind, PosePrior
from slam.backend.pose_graph.pose_graph_optimization import PoseGraphSolution, optimize_pose_graph
from slam.common.arrays import FloatArray
from slam.common.errors import FactorGraphError
from slam.common.geometry import invert, make_transform, transform_from_xyz_yaw

ROUND, TRUE = 60, 20
ODOMETRY_SIGMAS, CLOSURE_SIGMAS = np.repeat([0.003, 0.03], 3), np.repeat([0.01, 0.1], 3)
ANGLES = 2.0 * np.pi * np.arange(2 * ROUND) / ROUND
XYZ = np.column_stack([20.0 * np.cos(ANGLES), 20.0 * np.sin(ANGLES), 0.01 * np.arange(2 * ROUND)])
T_GT = transform_from_xyz_yaw(XYZ, ANGLES + 0.5 * np.pi)


def noise(sigmas: FloatArray, rng: np.random.Generator) -> FloatArray:
    errors = rng.normal(size=6) * sigmas
    return make_transform(Rotation.from_rotvec(errors[:3]).as_matrix(), errors[3:])


def odometry() -> list[Edge]:
    rng = np.random.default_rng(0)
    steps = [invert(T_GT[i]) @ T_GT[i + 1] @ noise(ODOMETRY_SIGMAS, rng) for i in range(2 * ROUND - 1)]
    return [Edge(i, i + 1, step, np.diag(ODOMETRY_SIGMAS**2), EdgeKind.ODOMETRY) for i, step in enumerate(steps)]


def closure(start: int, end: int, T: FloatArray) -> Edge:
    return Edge(start, end, T, np.diag(CLOSURE_SIGMAS**2), EdgeKind.LOOP_CLOSURE)


def true_closures(count: int, rng: np.random.Generator) -> list[Edge]:
    starts = np.linspace(0, ROUND - 1, count).astype(np.int64).tolist()
    return [closure(i, i + ROUND, invert(T_GT[i]) @ T_GT[i + ROUND] @ noise(CLOSURE_SIGMAS, rng)) for i in starts]


def false_closures(count: int, rng: np.random.Generator) -> list[Edge]:
    """Opposite places of the circle that are said to be one, more or less."""
    return [
        closure(
            start,
            start + ROUND // 2 + int(rng.integers(-10, 10)),
            transform_from_xyz_yaw(np.append(rng.uniform(-3.0, 3.0, 2), 0.0), rng.choice([0.0, np.pi])),
        )
        for start in rng.integers(0, ROUND, count).tolist()
    ]


def dead_reckoning(edges: list[Edge]) -> FloatArray:
    poses = [T_GT[0]]
    for edge in edges:
        poses.append(poses[-1] @ edge.T_from_to)
    return np.array(poses)


def solve(edges: list[Edge], closures: list[Edge], initial: FloatArray | None = None) -> PoseGraphSolution:
    initial = dead_reckoning(edges) if initial is None else initial
    return optimize_pose_graph(dict(enumerate(initial)), [PosePrior(0, T_GT[0], 1e-5), *edges], closures)


def with_false(true_count: int, false_count: int, seed: int = 1) -> list[Edge]:
    rng = np.random.default_rng(seed)
    return [*true_closures(true_count, rng), *false_closures(false_count, rng)]


def rmse_m(T: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.sum((T - T_GT)[:, :3, 3] ** 2, axis=1))))


@pytest.mark.parametrize("false_count", [0, 9, 30, 60])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_false_closures_are_rejected(false_count: int, seed: int) -> None:
    edges, closures = odometry(), with_false(TRUE, false_count, seed)
    clean, solved = solve(edges, with_false(TRUE, 0, seed)), solve(edges, closures)
    assert solved.message == ""
    assert rmse_m(solved.T_map_body) < 1.1 * rmse_m(clean.T_map_body) + 0.01
    assert rmse_m(solved.T_map_body) < 0.6 * rmse_m(dead_reckoning(edges))
    assert np.mean(solved.kept[:TRUE]) > 0.9
    assert np.all(solved.weights[TRUE:] < 0.01)
    if false_count:  # the twin
        certain = [replace(each, kind=EdgeKind.ODOMETRY) for each in closures]
        assert rmse_m(solve([*edges, *certain], [], dead_reckoning(edges)).T_map_body) > 5.0


def test_only_false_closures_leave_the_odometry() -> None:
    edges = odometry()
    solved = solve(edges, with_false(0, 40))
    assert solved.message == "none of 40 closures agrees with the rest; all were rejected"
    np.testing.assert_array_equal(solved.weights, np.zeros(40))
    np.testing.assert_allclose(solved.T_map_body, dead_reckoning(edges), atol=1e-6)


def test_a_graph_without_closures_is_solved() -> None:
    solved = solve(odometry(), [])
    assert solved.weights.shape == (0,)
    np.testing.assert_allclose(solved.T_map_body, dead_reckoning(odometry()), atol=1e-6)


def test_the_majority_wins_over_a_minority_that_fits_the_odometry() -> None:
    """The second round has slipped by 3 m, and five closures, of 17, say that it has not."""
    edges, right = odometry(), true_closures(12, np.random.default_rng(3))
    slip = edges[ROUND - 1].T_from_to @ transform_from_xyz_yaw(np.array([3.0, 0.0, 0.0]), 0.0)
    edges[ROUND - 1] = Edge(ROUND - 1, ROUND, slip, np.diag(np.repeat([0.01, 3.0], 3) ** 2.0), EdgeKind.ODOMETRY)
    slipped = dead_reckoning(edges)
    wrong = [closure(i, i + ROUND, invert(slipped[i]) @ slipped[i + ROUND]) for i in (0, 14, 29, 44, 59)]
    solved = solve(edges, [*right, *wrong])
    assert solved.kept.tolist() == [True] * 12 + [False] * 5
    assert rmse_m(solved.T_map_body) < 0.5


def test_the_initial_values_hardly_matter() -> None:
    edges, closures = odometry(), with_false(TRUE, 30)
    wrong = T_GT @ transform_from_xyz_yaw(np.array([3.0, -2.0, 0.0]), 0.5)
    assert rmse_m(wrong) > 3.0
    found = solve(edges, closures, wrong).T_map_body
    np.testing.assert_allclose(found, solve(edges, closures).T_map_body, atol=0.01)


def test_a_solution_that_did_not_converge_has_a_message(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("slam.backend.pose_graph.pose_graph_optimization.MAX_ITERATIONS", 1)
    assert "closures, no convergence within 1 iterations" in solve(odometry(), with_false(TRUE, 30)).message


def test_an_edge_to_an_unknown_keyframe_is_refused() -> None:
    with pytest.raises(FactorGraphError, match="the optimisation of the pose graph failed at keyframe 119"):
        solve(odometry(), [], T_GT[:-1])
