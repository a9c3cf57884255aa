"""Odometry with the faults corrected that a calibration names."""

from __future__ import annotations

import numpy as np
import pytest

from logs.messages import Odometry
from slam.common.calibration import OdometryCalibration
from slam.common.geometry import transform_from_xyz_yaw
from slam.odometry.calibrated_odometry import CalibratedOdometry


@pytest.mark.parametrize(("sources", "step"), [(1, 1), (2, 2)])
def test_of_two_sources_that_of_the_first_message_is_used(sources: int, step: int) -> None:
    poses = [transform_from_xyz_yaw(np.array([0.1 * row, 5.0 * (row % 2), 0.0]), 0.0) for row in range(20)]
    messages = [Odometry(row, T) for row, T in enumerate(poses)]
    calibrated = CalibratedOdometry(OdometryCalibration(sources=sources))
    assert [found for each in messages if (found := calibrated.correct(each)) is not None] == messages[::step]


def test_stamps_and_lengths_are_corrected() -> None:
    calibrated = CalibratedOdometry(OdometryCalibration(length_scale=1.5, time_offset_s=0.25))
    poses = [transform_from_xyz_yaw(np.array([float(row), 0.0, 0.0]), 0.0) for row in range(3)]
    found = [calibrated.correct(Odometry(row, T)) for row, T in enumerate(poses)]
    assert [(each.stamp_ns, each.T_odom_body[0, 3]) for each in found if each is not None] == [
        (250_000_000, 0.0),
        (250_000_001, 1.5),
        (250_000_002, 3.0),
    ]
