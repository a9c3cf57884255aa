from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from slam.common.errors import EvaluationError
from slam.common.geometry import apply, make_transform, transform_from_xyz_yaw
from slam.evaluation.metrics.alignment import align_path, align_se3, align_yaw_translation


@given(seed=st.integers(0, 2**32 - 1), noise=st.sampled_from([0.0, 0.1, 3.0]), count=st.integers(4, 30))
@settings(max_examples=60, deadline=None)
def test_se3_agrees_with_an_independent_solution(seed: int, noise: float, count: int) -> None:
    rng = np.random.default_rng(seed)
    points_gt = rng.normal(size=(count, 3)) * [10.0, 6.0, 3.0]
    T_true = make_transform(Rotation.random(rng=rng).as_matrix(), rng.normal(size=3) * 100.0)
    points_est = apply(np.linalg.inv(T_true), points_gt) + noise * rng.normal(size=(count, 3))
    T = align_se3(points_est, points_gt).T_world_map
    rotation, _ = Rotation.align_vectors(points_gt - points_gt.mean(axis=0), points_est - points_est.mean(axis=0))
    np.testing.assert_allclose(T[:3, :3], rotation.as_matrix(), atol=1e-6)
    np.testing.assert_allclose(T[:3, 3], points_gt.mean(axis=0) - T[:3, :3] @ points_est.mean(axis=0), atol=1e-9)
    if noise == 0.0:
        np.testing.assert_allclose(T, T_true, atol=1e-9)


@pytest.mark.parametrize("count", [3, 4, 20])
def test_alignment_of_mirrored_points_is_a_rotation(count: int) -> None:
    rng = np.random.default_rng(count)
    points = rng.normal(size=(count, 3))
    mirrored = align_se3(points, points * [1.0, 1.0, -1.0]).T_world_map
    flat = points * [1.0, 1.0, 0.0]
    planar = align_se3(flat, flat * [1.0, -1.0, 1.0]).T_world_map
    in_plane = align_yaw_translation(points, points * [1.0, -1.0, 1.0]).T_world_map
    for T in (mirrored, planar, in_plane):
        assert np.linalg.det(T[:3, :3]) == pytest.approx(1.0)
        np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)
    # A mirror image within the plane is a turn by pi about an axis in it.
    np.testing.assert_allclose(apply(planar, flat), flat * [1.0, -1.0, 1.0], atol=1e-9)


def test_align_yaw_translation_is_least_squares() -> None:
    rng = np.random.default_rng(3)
    points = rng.normal(size=(20, 3)) * 10.0
    T_true = transform_from_xyz_yaw(np.array([5.0, -3.0, 2.0]), 2.9)
    np.testing.assert_allclose(align_yaw_translation(points, apply(T_true, points)).T_world_map, T_true, atol=1e-12)
    noisy = apply(T_true, points) + rng.normal(size=points.shape)
    T = align_yaw_translation(points, noisy).T_world_map
    best = np.sum((apply(T, points) - noisy) ** 2)
    for delta in ([1e-3, 0, 0, 0], [0, 1e-3, 0, 0], [0, 0, 1e-3, 0], [0, 0, 0, 1e-4], [0, 0, 0, -1e-4]):
        nudged = transform_from_xyz_yaw(np.array(delta[:3]), delta[3]) @ T
        assert np.sum((apply(nudged, points) - noisy) ** 2) > best


def test_align_path_falls_back_on_straight_line() -> None:
    line = np.outer(np.linspace(0.0, 100.0, 50), [0.6, 0.8, 0.0])
    with pytest.raises(EvaluationError, match="straight line"):
        align_se3(line, line)
    alignment = align_path(line, apply(transform_from_xyz_yaw(np.array([1.0, 2.0, 3.0]), 0.4), line))
    assert alignment.kind == "yaw_translation"
    assert "straight line" in alignment.note
    np.testing.assert_allclose(
        alignment.T_world_map, transform_from_xyz_yaw(np.array([1.0, 2.0, 3.0]), 0.4), atol=1e-12
    )


def test_a_path_with_a_bend_is_aligned_in_se3_without_note() -> None:
    s = np.linspace(0.0, 100.0, 50)
    bend = np.stack([s, 0.01 * s**2, 0.0 * s], axis=1)
    assert (align_path(bend, bend).kind, align_path(bend, bend).note) == ("se3", "")


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (np.zeros((1, 3)), "at least 2"),
        (np.zeros((0, 3)), "at least 2"),
        (np.zeros((9, 3)), "moves"),
        (np.outer(np.arange(9.0), [0.0, 0.0, 1.0]), "moves"),
        (np.full((9, 3), np.nan), "finite"),
    ],
)
def test_degenerate_points_are_errors(points: np.ndarray, message: str) -> None:
    with pytest.raises(EvaluationError, match=message):
        align_path(points, points)
