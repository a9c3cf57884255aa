"""Rigid transforms: properties over uniform, near-identity and near-pi rotations, and against SciPy."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from slam.common.arrays import FloatArray
from slam.common.geometry import (
    apply,
    interpolate,
    invert,
    make_transform,
    rotation_angle_rad,
    transform_from_xyz_yaw,
    travelled_m,
    yaw_rad,
)

coordinates = st.floats(-1e3, 1e3)
vectors = st.tuples(coordinates, coordinates, coordinates).map(np.array)
unit = st.floats(-1.0, 1.0)
axes = st.tuples(unit, unit, unit).map(np.array).filter(lambda v: np.linalg.norm(v) > 0.1)
angles = st.one_of(
    st.floats(0.0, np.pi),
    st.floats(-12.0, -2.0).map(lambda exponent: 10.0**exponent),
    st.floats(-12.0, -2.0).map(lambda exponent: np.pi - 10.0**exponent),
    st.sampled_from([0.0, np.pi / 2, np.pi]),
)


def rotation(axis: FloatArray, angle_rad: float) -> FloatArray:
    return np.asarray(Rotation.from_rotvec(axis / np.linalg.norm(axis) * angle_rad).as_matrix())


rotations = st.builds(rotation, axes, angles)
transforms = st.builds(make_transform, rotations, vectors)


@given(transforms)
def test_inverse_is_that_of_the_matrix(T):
    np.testing.assert_allclose(invert(T), np.linalg.inv(T), atol=1e-9)


@given(transforms, st.lists(vectors, min_size=1, max_size=4).map(np.array))
def test_points_are_transformed_as_by_the_matrix(T_a_b, points_b):
    homogeneous = np.concatenate([points_b, np.ones((len(points_b), 1))], axis=1)
    np.testing.assert_allclose(apply(T_a_b, points_b), (homogeneous @ T_a_b.T)[:, :3], atol=1e-9)


@given(axes, angles, vectors)
def test_the_angle_is_exact_near_zero_and_near_pi(axis, angle_rad, xyz):
    T = make_transform(rotation(axis, angle_rad), xyz)
    np.testing.assert_allclose(rotation_angle_rad(T), angle_rad, rtol=1e-9, atol=1e-14)


@given(vectors, st.floats(-3.1, 3.1))
def test_yaw_goes_in_and_comes_out(xyz, yaw):
    T = transform_from_xyz_yaw(xyz, yaw)
    np.testing.assert_allclose(yaw_rad(T), yaw, atol=1e-12)
    np.testing.assert_array_equal(T[:3, 3], xyz)
    np.testing.assert_allclose(T[:3, :3], Rotation.from_euler("z", yaw).as_matrix(), atol=1e-15)


def test_nothing_in_gives_nothing_out():
    none = np.zeros((0, 4, 4))
    for function in (invert, rotation_angle_rad, yaw_rad):
        assert len(function(none)) == 0
    assert len(travelled_m(none[:, :3, 3])) == 0
    assert apply(np.eye(4), np.zeros((0, 3))).shape == (0, 3)
    assert transform_from_xyz_yaw(np.zeros((0, 3)), np.zeros(0)).shape == (0, 4, 4)


def test_travel_is_the_length_of_the_path_and_not_of_the_chord():
    positions = np.array([[0.0, 0, 0], [3, 4, 0], [3, 4, 2], [0, 0, 2]])
    np.testing.assert_allclose(travelled_m(positions), [0.0, 5.0, 7.0, 12.0])


@given(transforms, transforms, st.floats(0.0, 1.0))
def test_interpolation_is_scipys_slerp_and_a_straight_line(T_first, T_second, fraction):
    start_ns = 1_700_000_000_123_456_789
    stamps_ns = np.array([start_ns, start_ns + 100_000_000])
    at_ns = start_ns + np.array([0, round(fraction * 100_000_000), 100_000_000])
    T = interpolate(stamps_ns, np.stack([T_first, T_second]), at_ns)
    np.testing.assert_allclose(T[0], T_first, atol=1e-12)
    np.testing.assert_allclose(T[2], T_second, atol=1e-12)
    exact = (at_ns[1] - start_ns) / 100_000_000
    slerp = Slerp([0.0, 1.0], Rotation.from_matrix(np.stack([T_first[:3, :3], T_second[:3, :3]])))
    # At half a turn two arcs are equally short.
    if rotation_angle_rad(invert(T_first) @ T_second) < np.pi - 1e-6:
        np.testing.assert_allclose(T[1, :3, :3], slerp(exact).as_matrix(), atol=1e-7)
    np.testing.assert_allclose(T[1, :3, 3], (1 - exact) * T_first[:3, 3] + exact * T_second[:3, 3], atol=1e-9)


@pytest.mark.parametrize("count", [1, 2])
def test_interpolation_holds_the_poses_at_both_ends_and_has_none_at_no_time(count):
    T = transform_from_xyz_yaw(np.array([[1.0, 2, 3], [2, 2, 3]]), np.array([0.4, 0.7]))[:count]
    stamps_ns = np.array([5, 8])[:count]
    np.testing.assert_array_equal(interpolate(stamps_ns, T, np.array([0, 5])), T[[0, 0]])
    np.testing.assert_allclose(interpolate(stamps_ns, T, np.array([8, 90])), T[[-1, -1]], atol=1e-15)
    assert interpolate(stamps_ns, T, np.zeros(0, int)).shape == (0, 4, 4)


def test_a_stamp_of_another_century_does_not_blur_those_of_a_nanosecond():
    stamps_ns = np.array([0, 2**61, 2**61 + 2])
    T = transform_from_xyz_yaw(np.array([[0.0, 0, 0], [0, 0, 0], [2, 0, 0]]), np.array([0.0, 0.0, 0.2]))
    between = interpolate(stamps_ns, T, stamps_ns[1:2] + 1)[0]
    np.testing.assert_allclose(between, transform_from_xyz_yaw(np.array([1.0, 0, 0]), 0.1), atol=1e-12)
