"""Poses with most votes by matches of two objects."""

import numpy as np
import pytest

from slam.common.arrays import FloatArray
from slam.common.geometry import apply, transform_from_xyz_yaw, yaw_rad
from slam.place_recognition.place_search import vote_for_poses

QUERY = np.array([[-10.0, 0.0, 0.0], [10.0, 0.0, 0.0], [0.0, 0.0, 3.0]])
"""The last one is not matched."""


def voted(T_map_query: FloatArray, count: int, weights: list[float] | None = None) -> FloatArray:
    """Of one match a pose (C, 4, 4); cells are 1.4 m wide."""
    references = np.concatenate([apply(T, QUERY[:2]) for T in T_map_query])
    given = np.ones(len(T_map_query)) if weights is None else np.array(weights)
    rows = np.arange(len(references)).reshape(-1, 2)
    matches = np.tile([0, 1], (len(rows), 1))
    return vote_for_poses(QUERY, references, matches, rows, given, tolerance_m=1.0, count=count)


def at(*places: tuple[float, float], yaw: float = 0.3) -> FloatArray:
    return transform_from_xyz_yaw(np.array([[x, y, 2.0] for x, y in places]), np.full(len(places), yaw))


@pytest.mark.parametrize("count", [1, 2])
def test_cell_with_most_votes_is_first(count: int) -> None:
    poses = voted(at(*[(0.1, 0.0)] * 5, *[(40.0, 7.0)] * 4, (80.0, -3.0)), count)
    np.testing.assert_allclose(poses, at((0.1, 0.0), (40.0, 7.0))[:count], atol=1e-9)


def test_heavy_votes_are_more_than_many_light_ones() -> None:
    (best,) = voted(at(*[(0.0, 0.0)] * 5, *[(40.0, 7.0)] * 4), 1, [1.0] * 5 + [2.0] * 4)
    np.testing.assert_allclose(best[:2, 3], [40.0, 7.0])


def test_pose_is_the_weighted_mean_of_its_cell() -> None:
    (best,) = voted(at((0.0, 0.0), (1.0, 0.8)), 1, [3.0, 1.0])
    np.testing.assert_allclose(best[:3, 3], [0.25, 0.2, 2.0])


@pytest.mark.parametrize("yaw", [np.pi - 0.01, -np.pi + 0.01])
def test_headings_near_half_a_turn_are_kept(yaw: float) -> None:
    (best,) = voted(at(*[(0.0, 0.0)] * 3, yaw=yaw), 1)
    assert float(yaw_rad(best)) == pytest.approx(yaw)
