"""Areas of the plane."""

from __future__ import annotations

import numpy as np
import pytest

from slam.common.areas import Circle, Polygon
from slam.common.errors import GeometryError

L_SHAPE = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 1.0], [1.0, 1.0], [1.0, 4.0], [0.0, 4.0]])


def box(x0: float, y0: float, x1: float, y1: float) -> Polygon:
    return Polygon(np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]))


@pytest.mark.parametrize("corners", [L_SHAPE, L_SHAPE[::-1], np.roll(L_SHAPE, 2, axis=0)])
def test_a_polygon_may_be_concave_and_go_either_way(corners: np.ndarray) -> None:
    positions = np.array([[0.5, 0.5, 9.0], [3.0, 0.5, 0.0], [0.5, 3.0, 0.0], [3.0, 3.0, 0.0], [-1.0, 0.5, 0.0]])
    assert Polygon(corners).contains(positions).tolist() == [True, True, True, False, False]


def test_boxes_side_by_side_share_no_position() -> None:
    positions = np.stack(np.meshgrid(np.arange(5.0), np.arange(3.0)), axis=-1).reshape(-1, 2)
    left = box(-0.5, -0.5, 2.0, 2.5).contains(positions)
    right = box(2.0, -0.5, 4.5, 2.5).contains(positions)
    assert (left ^ right).all()
    assert not left[positions[:, 0] >= 2.0].any()


def test_a_circle_goes_by_distance_in_the_plane() -> None:
    assert Circle(1.0, 0.0, 2.0).contains(np.array([[3.0, 0.0, 50.0], [3.1, 0.0, 0.0]])).tolist() == [True, False]


@pytest.mark.parametrize(
    "make",
    [
        lambda: Circle(0.0, 0.0, 0.0),
        lambda: Polygon(L_SHAPE[:2]),
    ],
)
def test_an_area_of_nothing_is_refused(make: object) -> None:
    with pytest.raises(GeometryError):
        make()  # type: ignore[operator]


def test_no_positions() -> None:
    assert Polygon(L_SHAPE).contains(np.zeros((0, 3))).shape == (0,)
