"""Two sources of odometry on one topic, told apart message by message."""

from __future__ import annotations

import numpy as np
import pytest

from logs.messages import Odometry
from slam.common.geometry import transform_from_xyz_yaw
from slam.odometry.sources import FollowedSource

COUNT = 200


def message(row: int, aside_m: float, speed_mps: float = 8.0) -> Odometry:
    """On an arc, 20 messages a second; ``aside_m``: the source's origin."""
    seconds = 0.05 * row
    angle = 0.2 * seconds
    xyz = speed_mps / 0.2 * np.array([np.sin(angle), 1.0 - np.cos(angle), 0.0]) + [0.0, aside_m, 0.0]
    return Odometry(round(seconds * 1e9), transform_from_xyz_yaw(xyz, angle))


@pytest.mark.parametrize("aside_m", [0.2, 1.0, 300.0])
def test_messages_that_alternate_are_told_apart(aside_m: float) -> None:
    source = FollowedSource()
    assert [source.follows(message(row, aside_m * (row % 2))) for row in range(COUNT)] == [
        row % 2 == 0 for row in range(COUNT)
    ]


def test_lost_messages_do_not_exchange_the_sources() -> None:
    source = FollowedSource()
    rows = [row for row in range(COUNT) if row < 20 or row % 7]
    assert [source.follows(message(row, 1.0 * (row % 2))) for row in rows] == [row % 2 == 0 for row in rows]


def test_stamps_that_do_not_rise_change_no_velocity() -> None:
    source = FollowedSource()
    rows = [*range(20), 18, 19, *range(20, COUNT)]
    assert [source.follows(message(row, 1.0 * (row % 2))) for row in rows] == [row % 2 == 0 for row in rows]


def test_stamps_that_never_rise_tell_no_source() -> None:
    source = FollowedSource()
    assert [source.follows(message(5, 1.0 * (row % 2))) for row in range(COUNT)] == [
        row % 2 == 0 for row in range(COUNT)
    ]
