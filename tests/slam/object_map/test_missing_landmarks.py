"""Landmarks of a prior map that are passed at several closures and never matched."""

from __future__ import annotations

import numpy as np
import pytest

from slam.common.arrays import FloatArray, IntArray
from slam.common.calibration import ObjectCalibration
from slam.common.geometry import transform_from_xyz_yaw
from slam.object_map.landmarks import ObjectMap
from slam.object_map.missing_landmarks import MissingLandmarks
from slam.odometry.keyframe import Keyframe
from slam.odometry.pose import OdometryPose

SENSOR_RANGE_M = 30.0
START_M = 200.0
"""Where the map has the first pose of the drive."""
NONE = np.zeros(0, dtype=np.int64)


def at(x_m: float) -> FloatArray:
    return transform_from_xyz_yaw(np.array([x_m, 0.0, 0.0]), 0.0)


class Street:
    """Landmarks along the x axis, the last ``own_count`` of which are of the drive, and a keyframe every 5 m."""

    def __init__(self, landmarks_m: list[float], *, own_count: int = 0, breaks_at: int = 99) -> None:
        count = len(landmarks_m)
        positions = np.column_stack([landmarks_m, np.zeros((count, 2))])
        object_map = ObjectMap(ObjectCalibration())
        rows = object_map.add(
            positions, np.tile(np.eye(3), (count, 1, 1)), np.zeros(count, np.int64), stamp_ns=0, scan=0, travel_m=0.0
        )
        object_map.confirm(rows)
        object_map.assign(rows[count - own_count :], segment=1)
        self.keyframes = [Keyframe(0, OdometryPose(-1, np.eye(4), -1e9, 0, 1.0), np.eye(4), is_prior=True)]
        for number in range(1, 31):
            pose = OdometryPose(number, at(5.0 * number), 5.0 * number, 2 if number >= breaks_at else 1, 1.0)
            self.keyframes.append(Keyframe(number, pose, pose.T_odom_body))
        self.missing = MissingLandmarks(object_map, self.keyframes, SENSOR_RANGE_M)

    def close(self, number: int, matched: IntArray = NONE, *, times: int = 1) -> list[int]:
        """The missing landmarks after so many closures of a keyframe."""
        keyframe = self.keyframes[number]
        for _ in range(times):
            self.missing.add(keyframe, at(START_M + keyframe.odometry.travel_m), matched)
        return self.missing.rows().tolist()


def test_landmark_passed_at_six_closures_and_never_matched_is_missing() -> None:
    street = Street([START_M + 60.0, START_M + 300.0])
    assert street.close(20, times=5) == []
    assert street.close(20) == [0]


def test_landmark_matched_once_is_not_missing() -> None:
    street = Street([START_M + 60.0])
    street.close(20, np.array([0]))
    assert street.close(20, times=6) == []


@pytest.mark.parametrize(("x_m", "is_passed"), [(34.9, False), (35.1, True), (99.9, True), (100.1, False)])
def test_landmarks_are_passed_around_the_path_that_ended_half_a_sensor_range_ago(x_m: float, is_passed: bool) -> None:
    """The robot is at 100 m; of its last 50 m the first 35 m count, and what is within 15 m of them is passed."""
    assert Street([START_M + x_m]).close(20, times=6) == ([0] if is_passed else [])


def test_path_does_not_reach_across_a_break_of_the_odometry() -> None:
    assert Street([START_M + 60.0], breaks_at=18).close(20, times=6) == []
    assert Street([START_M + 60.0]).close(1, times=6) == []


def test_landmarks_of_the_drive_itself_are_not_missing() -> None:
    assert Street([START_M + 60.0, START_M + 61.0], own_count=1).close(20, times=6) == [0]
