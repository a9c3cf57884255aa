import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slam.common.errors import EvaluationError
from slam.common.geometry import apply, transform_from_xyz_yaw
from slam.evaluation.metrics.alignment import align_path, align_yaw_translation, find_axes
from tests.helpers.poses import motion_by, pose_at


@pytest.mark.parametrize("seed", range(2))
def test_both_alignments_are_least_squares(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(20, 3)) * [10.0, 6.0, 3.0]
    turned = transform_from_xyz_yaw(rng.normal(size=3) * 100.0, rng.uniform(-np.pi, np.pi))
    for align, T_true, axes in (
        (align_path, turned @ motion_by(rng.normal(size=3)), slice(3)),
        (align_yaw_translation, turned, slice(2, 3)),
    ):
        np.testing.assert_allclose(align(points, apply(T_true, points)), T_true, atol=1e-9)
        noisy = apply(T_true, points) + rng.normal(size=points.shape)
        T = align(points, noisy)
        best = np.sum((apply(T, points) - noisy) ** 2)
        for size in (-1e-3, 1e-3):
            for turn in size * np.eye(3)[axes]:
                assert np.sum((apply(T @ motion_by(turn), points) - noisy) ** 2) > best
            for shift in size * np.eye(3):
                assert np.sum((apply(T, points) + shift - noisy) ** 2) > best


def test_align_path_falls_back_on_straight_line() -> None:
    line = np.outer(np.linspace(0.0, 100.0, 50), [0.6, 0.8, 0.0])
    T_true = pose_at(1.0, 2.0, z=3.0, yaw=0.4)
    np.testing.assert_allclose(align_path(line, apply(T_true, line)), T_true, atol=1e-12)


@pytest.mark.parametrize("points", [np.zeros((1, 3)), np.zeros((9, 3)), np.outer(np.arange(9.0), [0.0, 0.0, 1.0])])
def test_points_without_heading_are_refused(points: np.ndarray) -> None:
    with pytest.raises(EvaluationError, match="moves"):
        align_path(points, points)


@pytest.mark.parametrize("angles_deg", [(180.0, 0.0, 0.0), (0.0, 0.0, 90.0), (-90.0, 0.0, -90.0), (0.0, 0.0, 0.0)])
def test_axes_of_another_program_are_found(angles_deg: tuple[float, float, float]) -> None:
    rng = np.random.default_rng(0)
    R_est, noise = (Rotation.random(50, rng=rng), Rotation.from_rotvec(rng.normal(0.0, 0.2, (50, 3))))
    axes = Rotation.from_euler("xyz", angles_deg, degrees=True)
    found = find_axes(R_est.as_matrix(), (R_est * noise * axes).as_matrix())
    np.testing.assert_allclose(found, axes.as_matrix(), atol=1e-12)


def test_orientations_that_are_not_known_have_the_same_axes() -> None:
    headings = Rotation.from_euler("z", np.linspace(0.0, 5.0, 50)[:, None]).as_matrix()
    np.testing.assert_array_equal(find_axes(headings, np.tile(np.eye(3), (50, 1, 1))), np.eye(3))
