import numpy as np
import pytest

from logs.clouds.one_sided import seen_from_all_sides, seen_from_one_side
from logs.messages import FloatArray
from tests.logs.clouds.clouds import post

ORIGIN = np.zeros(3)


def box_sides(centre: FloatArray, length_m: float, width_m: float, yaw: float) -> FloatArray:
    """Points of the sides of a box that face the origin."""
    R = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    half = 0.5 * np.array([length_m, width_m])
    faces = []
    for axis in (0, 1):
        for side in (-1.0, 1.0):
            normal = side * np.eye(2)[axis]
            if (R @ normal) @ (centre[:2] + R @ (half * normal)) >= 0.0:
                continue
            along = np.arange(-half[1 - axis], half[1 - axis] + 1e-9, 0.1)
            face = np.tile(half * normal, (len(along), 1))
            face[:, 1 - axis] = along
            faces.append(face @ R.T + centre[:2])
    ring = np.concatenate(faces)
    z = np.arange(-0.5, 1.0, 0.1)
    return np.column_stack([np.tile(ring, (len(z), 1)), np.repeat(z, len(ring))])


@pytest.mark.parametrize("bearing", [0.0, 1.0, 2.5, -2.0])
def test_the_axis_of_a_post_lies_behind_what_is_seen_of_it(bearing: float) -> None:
    axis = 10.0 * np.array([np.cos(bearing), np.sin(bearing)])
    points = post(*axis, radius_m=0.4)
    centre = seen_from_one_side(points, ORIGIN, 0.05, upright=True)
    seen_m = np.linalg.norm(seen_from_all_sides(points, 0.05).position[:2] - axis)
    assert seen_m == pytest.approx(0.4 * 2.0 / np.pi, abs=0.02)
    assert np.linalg.norm(centre.position[:2] - axis) < 0.5 * seen_m


@pytest.mark.parametrize("yaw", np.arange(0.1, 1.5, 0.2))
def test_the_centre_of_a_box_is_found_better_and_its_error_is_as_large_as_is_said(yaw: float) -> None:
    truth = np.array([12.0, 1.0, 0.25])
    points = box_sides(truth, 4.0, 1.8, yaw)
    centre = seen_from_one_side(points, ORIGIN, 0.1, upright=True)
    error = (centre.position - truth)[:2]
    naive = (points.mean(axis=0) - truth)[:2]
    assert np.linalg.norm(error) < (0.7 if yaw > 0.2 else 0.9) * np.linalg.norm(naive)  # below, one face is all of it
    assert error @ np.linalg.solve(centre.covariance[:2, :2], error) < 13.8  # chi-squared, 2 degrees of freedom, 99.9 %


def test_in_a_frame_whose_z_looks_ahead_it_is_the_same() -> None:
    R_optical_body = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
    points = post(10.0, 0.0, radius_m=0.4)
    upright = seen_from_one_side(points, ORIGIN, 0.05, upright=True)
    optical = seen_from_one_side(points @ R_optical_body.T, ORIGIN, 0.05, upright=False)
    np.testing.assert_allclose(R_optical_body.T @ optical.position, upright.position, atol=0.03)
