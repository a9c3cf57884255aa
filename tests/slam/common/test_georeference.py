"""Georeference: degrees to the plane and back, against known distances."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slam.common.errors import GeometryError
from slam.common.georeference import Georeference

DEGREES = st.tuples(st.floats(-80.0, 80.0), st.floats(-180.0, 180.0))


@given(origin=DEGREES, x=st.floats(-1e5, 1e5), y=st.floats(-1e5, 1e5), yaw=st.floats(-3.0, 3.0))
def test_degrees_and_metres_are_inverse(origin: tuple[float, float], x: float, y: float, yaw: float) -> None:
    georeference = Georeference(*origin, altitude_m=12.0, yaw_rad=yaw)
    position = np.array([[x, y, 3.0]])
    np.testing.assert_allclose(georeference.to_map(georeference.to_geodetic(position)), position, atol=1e-4)


def test_a_degree_has_the_length_that_it_has_on_the_ellipsoid() -> None:
    """110.574 km of latitude at the equator, 111.320 km of longitude, and half of that, nearly, at 60 degrees."""
    step = 1e-3
    at_equator = Georeference(0.0, 10.0).to_map(np.array([[step, 10.0, 0.0], [0.0, 10.0 + step, 0.0]]))
    np.testing.assert_allclose(at_equator[:, :2], [[0.0, 110.574], [111.320, 0.0]], atol=1e-3)
    north = Georeference(60.0, 24.9).to_map(np.array([[60.0, 24.9 + step, 5.0]]))
    np.testing.assert_allclose(north, [[55.800, 0.0, 5.0]], atol=1e-3)


def test_the_heading_turns_the_axes() -> None:
    """A map whose x axis points north: what lies north of the origin has a positive x."""
    north = Georeference(48.0, 11.0, yaw_rad=np.pi / 2).to_map(np.array([[48.001, 11.0, 0.0]]))
    assert north[0, 0] > 100.0
    assert abs(north[0, 1]) < 1e-6


def test_text_gives_it_back() -> None:
    georeference = Georeference(48.1, 11.5, 510.0, 0.3)
    assert Georeference.from_json(georeference.to_json()) == georeference
    with pytest.raises(GeometryError, match="not a georeference"):
        Georeference.from_json('{"latitude": 3}')


def test_metres_are_no_origin() -> None:
    with pytest.raises(GeometryError, match=r"latitude 1200, longitude -3.*degrees"):
        Georeference(1200.0, -3.0)
