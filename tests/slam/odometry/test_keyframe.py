"""When a next keyframe is due."""

from __future__ import annotations

import numpy as np
import pytest

from slam.common.geometry import transform_from_xyz_yaw
from slam.odometry.keyframe import is_keyframe_due
from slam.odometry.pose import OdometryPose


def pose(seconds: float, travel_m: float, *, yaw_rad: float = 0.0, segment: int = 0) -> OdometryPose:
    T = transform_from_xyz_yaw(np.array([travel_m, 0.0, 0.0]), yaw_rad)
    return OdometryPose(round(seconds * 1e9), T, travel_m, segment, 1.0)


@pytest.mark.parametrize(
    ("now", "is_due"),
    [
        (pose(1.0, 1.9), False),
        (pose(1.0, 2.0), True),
        (pose(1.0, 0.0, yaw_rad=np.deg2rad(19.0)), False),
        (pose(1.0, 0.0, yaw_rad=np.deg2rad(21.0)), True),
        (pose(1.0, 0.0, segment=1), True),
        (pose(4.9, 0.2), False),
        (pose(5.0, 0.2), True),
        (pose(5.0, 0.0, yaw_rad=0.03), True),
        (pose(500.0, 0.05, yaw_rad=0.01), False),
    ],
)
def test_a_keyframe_is_due_after_a_way_a_turn_a_break_or_a_time_in_motion(now, is_due):
    assert is_keyframe_due(pose(0.0, 0.0), now, 2.0, sensor_range_m=30.0) is is_due
