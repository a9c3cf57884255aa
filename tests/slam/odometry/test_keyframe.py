"""When a next keyframe is due."""

from dataclasses import replace

import numpy as np
import pytest

from slam.common.config import Config
from slam.odometry.keyframe import is_keyframe_due
from tests.helpers.poses import keyframe_at, pose_at

CONFIG = Config.model_validate({"keyframe": {"distance_m": 2.0}})


@pytest.mark.parametrize(
    ("seconds", "moved_m", "turn_deg", "is_due"),
    [
        (1.0, 1.9, 0.0, False),
        (1.0, 2.0, 0.0, True),
        (1.0, 0.0, 19.0, False),
        (1.0, 0.0, 21.0, True),
        (4.9, 0.2, 0.0, False),
        (5.0, 0.2, 0.0, True),
        (5.0, 0.0, 2.0, True),
        (500.0, 0.05, 0.5, False),
    ],
)
def test_a_keyframe_is_due_after_a_way_a_turn_or_a_time_in_motion(seconds, moved_m, turn_deg, is_due):
    first = keyframe_at(pose_at(3.0, 1.0, yaw=0.7))
    T = first.T_local_body @ pose_at(0.0, moved_m, yaw=np.deg2rad(turn_deg))
    pose = replace(first.odometry, stamp_ns=round(seconds * 1e9), T_odom_body=T)
    assert is_keyframe_due(first, pose, T, CONFIG) is is_due


@pytest.mark.parametrize(("seconds", "is_due"), [(4.9, False), (5.0, True)])
def test_wheels_that_turn_while_the_body_stands_are_motion(seconds, is_due):
    first, moved = keyframe_at(pose_at(3.0, 1.0)), pose_at(6.0, 1.0)
    pose = replace(first.odometry, stamp_ns=round(seconds * 1e9), T_odom_body=moved)
    assert is_keyframe_due(first, pose, first.T_local_body, CONFIG) is is_due
